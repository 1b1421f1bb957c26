/// palpate completion: prints shell completion for the verbs and options.
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/engine/version.h"
#include "palpate/scenes/apps/common/options.h"

namespace palpate::cli {
namespace {

struct Verb {
  std::string name;
  std::string what;
  OrderedJson options;
};

/// Returns the options of palpate import, which the importer itself defines.
OrderedJson optionsOfImport() {
  for (const char* name : {"palpate-import", "palpate-import-light"}) {
    const std::filesystem::path program = programFolder() / name;
    if (!std::filesystem::exists(program)) continue;
    const std::string command = shellWord(program.string()) + " " + kOptionsOption;
    const auto close = [](std::FILE* file) { pclose(file); };
    const std::unique_ptr<std::FILE, decltype(close)> from(popen(command.c_str(), "r"), close);
    std::string text;
    for (int c = 0; from && (c = std::getc(from.get())) != EOF;) text += static_cast<char>(c);
    OrderedJson options = OrderedJson::parse(text, nullptr, /*allow_exceptions=*/false);
    if (options.is_array()) return options;
  }
  throw Error("palpate-import-light", "it does not say its options", "check the installation");
}

std::vector<Verb> verbsOf(const CLI::App& app) {
  std::vector<Verb> verbs;
  for (const CLI::App* verb : app.get_subcommands({})) {
    const bool import = verb->get_name() == "import";
    verbs.push_back(
        {verb->get_name(), verb->get_description(), import ? optionsOfImport() : optionsOf(*verb)});
  }
  // The verb help completes to the other verbs.
  for (Verb& verb : verbs) {
    if (verb.name != "help") continue;
    for (auto& option : verb.options) {
      if (!option["names"].empty()) continue;
      for (const Verb& one : verbs) option["values"].push_back(one.name);
    }
  }
  return verbs;
}

std::string namesOf(const std::vector<Verb>& verbs) {
  std::string names;
  for (const Verb& verb : verbs) names += (names.empty() ? "" : " ") + verb.name;
  return names;
}

std::string joined(const OrderedJson& words, const std::string& between) {
  std::string text;
  for (const auto& word : words) text += (text.empty() ? "" : between) + word.get<std::string>();
  return text;
}

std::string forBash(const std::vector<Verb>& verbs, const OrderedJson& own) {
  std::string all = namesOf(verbs);
  std::string values;
  std::string options;
  for (const Verb& verb : verbs) {
    std::string names;
    for (const auto& option : verb.options) {
      const std::string its = joined(option["names"], " ");
      if (!its.empty()) names += (names.empty() ? "" : " ") + its;
      if (option["values"].empty()) continue;
      // Values of positional arguments are offered unless an option has values of its own.
      const std::string before = its.empty() ? "*" : joined(option["names"], "|" + verb.name + ":");
      values += fmt::format("        {}:{}) words='{}' ;;\n", verb.name, before,
                            joined(option["values"], " "));
    }
    options += fmt::format("            {}) words='{}' ;;\n", verb.name, names);
  }
  for (const auto& option : own) all += " " + joined(option["names"], " ");
  return fmt::format(R"(_palpate() {{
    local word=${{COMP_WORDS[COMP_CWORD]}} verb=${{COMP_WORDS[1]}} words=
    if [ "$COMP_CWORD" -eq 1 ]; then
        words='{}'
    elif [[ $word == -* ]]; then
        case $verb in
{}        esac
    else
        case $verb:${{COMP_WORDS[COMP_CWORD-1]}} in
{}        esac
    fi
    # A colon ends a word: what follows it begins one.
    [ "$word" != : ] || word=
    if [ -n "$words" ]; then
        mapfile -t COMPREPLY < <(compgen -W "$words" -- "$word")
    else
        mapfile -t COMPREPLY < <(compgen -f -- "$word")
    fi
    if [[ ${{#COMPREPLY[@]}} -eq 1 && ${{COMPREPLY[0]}} == *: ]]; then
        compopt -o nospace +o filenames 2>/dev/null || true
    fi
}}
complete -o filenames -F _palpate palpate
)",
                     all, options, values);
}

/// Quotes text for a specification of _arguments or _describe, in single quotes.
std::string quoted(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '\'') {
      out += "'\\''";
    } else if (c == ':' || c == '[' || c == ']' || c == '\\') {
      out += std::string("\\") + c;
    } else {
      out += c;
    }
  }
  return out;
}

/// Returns the specification of an option or a positional argument for _arguments.
std::string specification(const OrderedJson& option) {
  std::string value;
  if (!option["takes"].is_null()) {
    const std::string takes = option["takes"].get<std::string>();
    const bool number = takes == "FLOAT" || takes == "INT" || takes == "UINT";
    value =
        fmt::format(":{}:{}", quoted(takes),
                    !option["values"].empty() ? "(" + quoted(joined(option["values"], " ")) + ")"
                    : number                  ? " "
                                              : "_files");
  }
  const std::string again = option["again"].get<bool>() ? "*" : "";
  if (option["names"].empty()) return fmt::format(" \\\n        '{}{}'", again, value);
  std::string text;
  for (const auto& name : option["names"]) {
    text += fmt::format(" \\\n        '{}{}[{}]{}'", again, name.get<std::string>(),
                        quoted(option["what"].get<std::string>()), value);
  }
  return text;
}

std::string forZsh(const std::vector<Verb>& verbs, const OrderedJson& own) {
  std::string names;
  std::string cases;
  for (const Verb& verb : verbs) {
    names += fmt::format("        '{}:{}'\n", verb.name, quoted(verb.what));
    std::string all;
    for (const auto& option : verb.options) all += specification(option);
    cases += fmt::format("    {}) _arguments{} ;;\n", verb.name, all);
  }
  std::string options;
  for (const auto& option : own) options += specification(option);
  return fmt::format(R"(#compdef palpate
_palpate() {{
    local -a verbs=(
{}    )
    if (( CURRENT == 2 )); then
        _describe verb verbs
        _arguments{}
        return
    fi
    shift words
    (( CURRENT-- ))
    case $words[1] in
{}    esac
}}
if [[ $funcstack[1] == _palpate ]]; then
    _palpate "$@"
else
    compdef _palpate palpate
fi
)",
                     names, options, cases);
}

}  // namespace

void addCompletion(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "completion", "Prints what a shell completes verbs and options by, for bash or zsh");
  auto shell = std::make_shared<std::string>();
  verb->add_option("SHELL", *shell, "bash or zsh")
      ->required()
      ->check(CLI::IsMember({"bash", "zsh"}));
  verb->footer(
      "Examples:\n  source <(palpate completion bash)\n"
      "  palpate completion zsh > ~/.zfunc/_palpate   (a folder of your fpath)");
  verb->callback([=, &app, &body] {
    body = [=, &app] {
      const std::vector<Verb> verbs = verbsOf(app);
      const OrderedJson own = optionsOf(app);
      sayRaw(*shell == "bash" ? forBash(verbs, own) : forZsh(verbs, own));
      return kDone;
    };
  });
}

}  // namespace palpate::cli
