/// Private to palpate: modules, which are shared libraries that are loaded at their first use,
/// because they need further libraries.
#pragma once

#include <string>

#include "palpate/engine/version.h"

namespace palpate {

/// Names a module.
struct Module {
  const char* file;    ///< Name of its file.
  const char* needed;  ///< The Debian package that a build with this module needs.
};

/// A module exports one symbol, palpate_module, which begins with this struct.
struct ModuleVersion {
  const char* version = kVersion;  ///< The release of palpate that the module belongs to.
};
/// The whole symbol. Module and user declare the function's type in a header that both include.
template <class Function>
struct ModuleEntry : ModuleVersion {
  /// Makes the symbol of a module with this function.
  constexpr explicit ModuleEntry(Function* of) noexcept : function(of) {}
  Function* function;  ///< The function that the module offers.
};

/// Loads a module and returns its symbol. Never unloads it, because it may have threads.
///
/// The folder is $PALPATE_MODULES if this is an absolute path, else ../lib/palpate of the program
/// or library that contains this function. If that folder does not exist, the search covers palpate
/// in the folder `lib` above the program, and the system's folders. A program with more rights than
/// its user searches only the system's folders. Throws Error if no folder has the file, if it
/// cannot be loaded, or if all belong to other releases of palpate. Not for a tick: reads files.
///
/// @param subject  Error::subject(): the option, file or address that needs the module.
[[nodiscard]] const ModuleVersion& loadModule(const Module& module, const std::string& subject);

/// Returns the function of a module. Throws as loadModule() does.
template <class Function>
[[nodiscard]] Function* functionOf(const Module& module, const std::string& subject) {
  return static_cast<const ModuleEntry<Function>&>(loadModule(module, subject)).function;
}

}  // namespace palpate
