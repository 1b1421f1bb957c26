"""Tables of the keys in JSON Schemas, for docs/interfaces.py."""
import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SCHEMAS = {"scene": "scenes/scene.schema.json", "arm": "devices/hid/hid_profile.schema.json"}
KEYS = "`NAME` stands for a name of your choice, and `[]` for each element of a list. If only some forms of an object" \
       " have a key, the description names these forms."
# Keywords that the tables do not show. A key's description says what its allOf requires.
SKIPPED = {"$schema", "title", "definitions", "minLength", "minProperties", "allOf"}
SHOWN = {"$ref", "const", "dependencies", "description", "enum", "items", "oneOf", "pattern", "properties", "required",
         "type", "minimum", "exclusiveMinimum", "maximum", "not", "minItems", "maxItems", "additionalProperties"}


class Refused(Exception):
    """The page cannot be generated, or differs."""


def cell(text):
    """Returns text for a cell of a table, with links to pages."""
    text = re.sub(r"[|*`]", r"\\\g<0>", text).replace("<", "&lt;")
    return re.sub(r"docs/(\w+\.md)", r"[\1](\1)", text)


def number(value):
    return f"{value:,.10g}" if isinstance(value, (int, float)) else f"`{value}`"


def limits(node, least, most):
    """Returns the range of a number, or of a number of elements."""
    above, low, high = (node.get(key) for key in ("exclusiveMinimum", least, most))
    if low is not None and high is not None and above is None:
        return number(low) if low == high else f"{number(low)} to {number(high)}"
    return ", ".join(f"{sign} {number(x)}" for sign, x in ((">", above), ("≥", low), ("≤", high)) if x is not None)


def kind(node, schema):
    """Returns the type and the range of a value."""
    unknown = node.keys() - SHOWN - SKIPPED
    if unknown:
        raise Refused(f"{SCHEMAS[schema]}: {min(unknown)}: the keyword is not known: add it to docs/schema_keys.py")
    if "$ref" in node:
        name = node["$ref"].split("/")[-1]
        return f"[{name}](#{schema}-{name})", ""
    if "oneOf" in node:
        kinds = [kind(n, schema) for n in node["oneOf"]]
        return tuple(" or ".join(dict.fromkeys(words for words in column if words)) for column in zip(*kinds))
    values = [node["const"]] if "const" in node else node.get("enum")
    if values:
        return "string" if isinstance(values[0], str) else "number", ", ".join(map(number, values))
    if isinstance(node.get("items"), list):
        return f"[{', '.join(' '.join(kind(n, schema)).strip() for n in node['items'])}]", ""
    if node.get("type") == "array":
        of, each = kind(node["items"], schema)
        count = limits({k: v for k, v in node.items() if v != 0}, "minItems", "maxItems")
        each = ", ".join(words for words in (count and f"{count} elements", each) if words)
        return f"list of {of}{'s' if of.isalpha() else ''}", each
    if isinstance(node.get("additionalProperties"), dict):
        return f"{kind(node['additionalProperties'], schema)[0]} for each `NAME`", ""
    outside = ["not 0"] if "not" in node else []
    pattern = ["`" + node["pattern"].replace("|", r"\|") + "`"] if "pattern" in node else []
    return node.get("type", "any"), ", ".join([*filter(None, [limits(node, "minimum", "maximum")]), *outside, *pattern])


def forms(node):
    """Returns each form of an object. Forms without keys are values of other types."""
    return [form for one in node["oneOf"] for form in forms(one)] if "oneOf" in node else [node]


def rows_of(path, node, schema):
    """Yields the row of one key, and the rows of the objects inside."""
    text, default = node.get("description", ""), ""
    if stated := re.search(r" ?The default is ([^;]+?)\.(?= |$)", text):
        text, default = text.replace(stated[0], "").strip(), stated[1]
    yield (path, *kind(node, schema), cell(default), cell(text))
    for key, suffix in (("items", "[]"), ("additionalProperties", ".NAME")):
        if isinstance(node.get(key), dict):
            yield from rows(node[key], schema, f"{path}{suffix}.")
    yield from rows(node, schema, f"{path}.")


def rows(node, schema, path=""):
    """Returns (key, type, range, default, description) of the keys of an object in all its forms."""
    objects = [form for form in forms(node) if "properties" in form]
    # Keys whose values tell the forms apart.
    consts = dict.fromkeys((key, child["const"]) for form in objects for key, child in form["properties"].items()
                           if "const" in child)
    tags = {key: [value for other, value in consts if other == key] for key, _ in consts}
    tags = {key: values for key, values in tags.items() if len(values) > 1}
    found, has, must, needs = {}, {}, {}, {}
    for form in objects:
        others = [key for other in objects if other is not form for key in other["properties"]]
        own = [key for key in form.get("required", []) if key not in others]
        name = " ".join(form["properties"][key]["const"] for key in tags if key in form["properties"])
        name = name or "".join(own[:1])
        needs.update(form.get("dependencies", {}))
        for key, child in form["properties"].items():
            has.setdefault(key, []).append(name)
            must.setdefault(key, []).extend([name] if key in form.get("required", []) else [])
            for row in rows_of(path + key, {"enum": tags[key]} if key in tags else child, schema):
                found.setdefault((key, row), []).append(name)
    result = []
    for (key, (at, of, each, default, text)), names in found.items():
        if at == path + key:
            if must[key]:
                all_of_them = "one of these" if len(objects) > 1 and names == [key] else "required"
                default = all_of_them if must[key] == has[key] else f"required with {', '.join(must[key])}"
            text += f" Needs {', '.join(f'`{other}`' for other in needs[key])}." if key in needs else ""
        text = text.strip()
        # The row of an object says to which forms its keys belong.
        told = ", ".join(dict.fromkeys(names))  # two forms may have one name
        if len(names) < len(objects) and names != [key] and (at == path + key or names != has[key]):
            text = f"With {told}: {text}" if text else f"With {told}."
        result.append((at, of, each, default, text))
    return result


def keys():
    """Returns the tables of the schemas' keys."""
    lines = []
    for schema, file in SCHEMAS.items():
        root = json.loads((ROOT / file).read_text("utf-8"))
        lines += [f"## {schema} keys", "", f"{cell(root['description'])} [{file}](../{file}) is the schema. {KEYS}", ""]
        for name, node in {"": root, **root["definitions"]}.items():
            table = [f"| `{key}` | {' | '.join(cells)} |" for key, *cells in rows(node, schema)]
            plain = [n for n in forms(node) if "properties" not in n]
            lines += [f"### {schema} {name}", ""] if name else []
            if plain:
                of, each = kind({"oneOf": plain}, schema)
                lines += [f"Type: {of}{each and '; range: '}{each}" + ("; or an object:" if table else "."), ""]
            head = ["| key | type | range | default | description |", "|---|---|---|---|---|"]
            lines += [*head, *table, ""] if table else []
    return lines
