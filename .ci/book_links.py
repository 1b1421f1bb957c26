"""A hook for mkdocs: replaces links out of docs/ by their text, because the book does not contain the linked
sources."""
import posixpath
import re

LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)#\s]+)(#[^)\s]*)?\)")


DEFINED = re.compile(r"^\[([^\]]+)\]: (\.\./\S+)\n", re.M)


def on_page_markdown(markdown, page, config, files):
    here = posixpath.dirname(page.file.src_uri)

    def kept(match):
        words, target = match[1], match[2]
        if re.match(r"[a-z]+:", target):
            return match[0]
        inside = posixpath.normpath(posixpath.join(here, target))
        if inside == "../README.md":
            return f"[{words}]({posixpath.relpath('index.md', here or '.')})"
        if inside.startswith("../"):
            return f"{words} (`{inside[3:]}`)" if inside[3:] not in words else words
        return match[0]

    # [words][label] with [label]: ../file below.
    for label, target in DEFINED.findall(markdown):
        if not posixpath.normpath(posixpath.join(here, target)).startswith("../"):
            continue
        markdown = markdown.replace(f"[{label}]: {target}\n", "")
        markdown = re.sub(rf"\[([^\]]+)\]\[{re.escape(label)}\]", r"\1", markdown)
        markdown = markdown.replace(f"[{label}][]", label)
    return LINK.sub(kept, markdown)
