#!/usr/bin/env python3
"""Writes docs/interfaces.md from the programs' --help and from the JSON Schemas: interfaces.py BIN [--check].

BIN is the folder of the programs, for example build/release/bin. With --check the script writes no file: if the page
differs, the script fails, names the first difference, and prints the command that writes the page again."""
import argparse
import re
import subprocess
import sys
from pathlib import Path

sys.dont_write_bytecode = True
from schema_keys import ROOT, Refused, cell, keys  # noqa: E402

PAGE = ROOT / "docs" / "interfaces.md"
VERBS = ROOT / "docs" / "verbs.md"  # written by hand
PROGRAMS = ("palpate-import", "palpate-view")
INTRODUCTION = """\
# Options and keys

<!-- docs/interfaces.py writes this page from the programs and the schemas. Do not edit it. -->

This page lists the options of each verb of `palpate`, the keys of [scene files](#scene-keys), and the keys of [arms'
profiles](#arm-keys). [Commands](verbs.md) describes the output and the guarantees of the verbs. Every verb has
`--help`, which prints its options. `palpate schema` prints the schemas.
"""


def help_of(program, *words):
    """Returns the blocks of a help text: purpose and usage, tables, examples."""
    try:
        done = subprocess.run([program, *words, "--help"], stdin=subprocess.DEVNULL, capture_output=True,
                              encoding="utf-8", check=True)
    except (OSError, subprocess.CalledProcessError) as e:
        raise Refused(f"{program}: {e}: build the programs") from e
    return [block.split("\n") for block in re.split(r"\n\n+", done.stdout.strip())]


def pairs(lines):
    """Returns [name, meaning] of each entry of a table by CLI11. The second column begins at 30."""
    found = []
    for line in lines:
        apart = line[29:30] == " "
        if line[:30].strip():
            found.append([(line[:30] if apart else line).strip(), ""])
        found[-1][1] = f"{found[-1][1]} {line[30:] if apart else ''}".strip()
    return found


def slug(heading):
    """Returns the anchor of a heading without options, as GitHub and mkdocs derive it."""
    return re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-")


def options(blocks, more=""):
    """Returns the heading and the lines of a help text's section."""
    heading = blocks[0][-1].removeprefix("Usage: ").removeprefix("palpate ").replace("[OPTIONS] ", "")
    rows, rest = [], []
    for block in blocks[1:]:
        if block[0] not in ("Positionals:", "Options:"):
            rest += ["", *block] if rest else block
            continue
        for name, meaning in pairs(block[1:]):
            must = "Required. " if " REQUIRED" in name else ""
            name = re.sub(r"(?<! in) \[([^\[\]]*)\]$", r"=\1", name)  # a default as CLI11 2.4 prints it
            name = name.replace(" REQUIRED", "") if name[0] == "-" else re.sub(" REQUIRED| TEXT(?!:)", "", name)
            rows += [] if name == "-h,--help" else [f"| `{name}` | {(must + cell(meaning)).strip()} |"]
    table = ["| argument | meaning |", "|---|---|", *rows, ""] if rows else []
    shown = ["```", *rest, "```", ""] if rest else []
    purpose = cell(" ".join(blocks[0][:-1]).rstrip("."))
    return heading, [f"## {heading}", "", f"{purpose}. {more}".rstrip(), "", *table, *shown]


def programs(folder):
    """Returns the part about palpate's verbs, and the programs beside it."""
    top = help_of(folder / "palpate")
    purposes = dict(pair for block in top if block[0] == "Subcommands:" for pair in pairs(block[1:]))
    described = {words.split()[0]: words for words in re.findall("^## (.*)", VERBS.read_text("utf-8"), flags=re.M)}
    for verb in sorted(purposes.keys() ^ described.keys()):
        raise Refused(f"docs/{VERBS.name}: verb {verb}: " + (
            "the page has no section for it: add one" if verb in purposes else "palpate has no such verb: delete it"))
    table, sections = ["| verb | purpose |", "|---|---|"], []
    helps = {verb: help_of(folder / "palpate", verb) for verb in purposes}
    for verb, blocks in helps.items():
        heading, lines = options(blocks, f"[Output and guarantees]({VERBS.name}#{slug(described[verb])}).")
        table.append(f"| [{verb}](#{slug(heading)}) | {cell(purposes[verb])} |")
        sections += lines
    for program in PROGRAMS:
        blocks = help_of(folder / program)
        same = [f"It has the options of `palpate {verb}`." for verb in helps if helps[verb] == blocks]
        sections += [f"## {program}", "", *same, ""] if same else options(blocks)[1]
    return [*table, "", *sections]


def difference(old, new):
    """Returns the number of the first line that differs, and both texts around the difference."""
    old, new = old.split("\n"), new.split("\n")
    at = next(i for i in range(len(new) + 1) if old[i:i + 1] != new[i:i + 1])
    before, after = "".join(old[at:at + 1]), "".join(new[at:at + 1])
    same = max(0, next((i for i, (a, b) in enumerate(zip(before, after)) if a != b), 0) - 20)
    return at + 1, before[same:same + 70], after[same:same + 70]


def main():
    parser = argparse.ArgumentParser(description="Writes docs/interfaces.md from the programs and the schemas.")
    parser.add_argument("bin", type=Path, help="the folder of the programs, for example build/release/bin")
    parser.add_argument("--check", action="store_true", help="writes no file; fails if the page differs")
    arguments = parser.parse_args()
    try:
        text = "\n".join([INTRODUCTION, *programs(arguments.bin), *keys()]).rstrip() + "\n"
        if not arguments.check:
            PAGE.write_text(text, "utf-8")
        elif (before := PAGE.read_text("utf-8")) != text:
            line, has, prints = difference(before, text)
            raise Refused(f'docs/{PAGE.name}:{line}: the page has "{has}", the programs and schemas have "{prints}": '
                          f"run docs/interfaces.py {arguments.bin}")
    except (Refused, OSError) as e:
        sys.exit(f"interfaces: {e}")


if __name__ == "__main__":
    main()
