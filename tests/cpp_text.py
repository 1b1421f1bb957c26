"""Reads C++ sources as text."""
import re

# Strings come first: they may contain what begins a comment. Numbers come before characters: a number may contain a '.
TOKEN = re.compile(
    rb'R"([^()\\\s]{0,16})\(.*?\)\1"'
    rb'|"(?:\\.|[^"\\\n])*"'
    rb"|\b\d(?:'?[\w.])*"
    rb"|'(?:\\.|[^'\\\n])*'"
    rb"|(?P<comment>[ \t]*(?://[^\n]*|/\*.*?\*/))", re.DOTALL)


def code_of(text):
    """Returns the bytes of a source without comments and empty lines. NOLINT comments stay."""
    def kept(match):
        comment = match["comment"]
        if comment:
            return match[0] if b"NOLINT" in comment else b" "
        # Line ends in raw strings must stay.
        return match[0].replace(b"\n", b"\0")
    lines = TOKEN.sub(kept, text).splitlines()
    return b"\n".join(line.rstrip() for line in lines if line.strip())
