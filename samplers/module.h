/// Private to palpate: loads modules at their first use. A module is a shared library with code
/// that needs further libraries.
#pragma once

#include <string>

#include "palpate/engine/version.h"

namespace palpate {

/// Names a module, and the package that a user needs to build it.
struct Module {
  const char* file;    ///< Name of the module's file, without a folder.
  const char* needed;  ///< The Debian package that a build with this module needs.
};

/// A module exports one symbol, palpate_module, which begins with this struct.
struct ModuleVersion {
  const char* version = kVersion;  ///< The release of palpate that the module belongs to.
};
/// The type of the symbol palpate_module. The module and its caller include one header that
/// declares the type of the function.
template <class Function>
struct ModuleEntry : ModuleVersion {
  /// Makes the symbol of a module that offers the function `of`.
  constexpr explicit ModuleEntry(Function* of) noexcept : function(of) {}
  Function* function;  ///< The function that the module offers.
};

/// Loads a module and returns its symbol. Never unloads the module, because the module may have
/// threads.
///
/// Searches only $PALPATE_MODULES if this is an absolute path, else only ../lib/palpate, relative
/// to the folder of the program or library that contains this function. If ../lib/palpate does not
/// exist, searches the folder `palpate` in the nearest folder `lib` above that program or library,
/// then the folders /usr/local/lib/palpate and /usr/lib/palpate. A program with more rights than
/// its user searches only the last two folders. Throws Error if no folder has the file, if the
/// first file that is found cannot be loaded, or if all files found belong to other releases of
/// palpate. Not for a tick: reads files.
///
/// @param subject  Error::subject(): the option, file or address that needs the module.
[[nodiscard]] const ModuleVersion& loadModule(const Module& module, const std::string& subject);

/// Returns the function of a module. Throws as loadModule() does.
template <class Function>
[[nodiscard]] Function* functionOf(const Module& module, const std::string& subject) {
  return static_cast<const ModuleEntry<Function>&>(loadModule(module, subject)).function;
}

}  // namespace palpate
