"""Write web/isogi_web/documents.d.ts: the server's documents as types of the page, from its
OpenAPI; by ``make schemas``.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from fastapi import FastAPI

from isogi_server.api.app import ROUTERS

TYPES = Path(__file__).parents[2] / "web" / "isogi_web" / "documents.d.ts"

READ = (
    *("SceneList", "SceneSchema", "CameraSchema", "PointSchema", "SizeSchema", "Coverage"),
    *("CardSchema", "CardChunks", "JobSchema"),
)
"""The documents that the page reads, with all that is in them."""


def types() -> str:
    """The text of the file."""
    app = FastAPI()
    for router in ROUTERS:
        app.include_router(router)
    schemas = app.openapi()["components"]["schemas"]
    names = sorted({each for name in READ for each in within(name, schemas)})
    head = "/** The server's documents, from its OpenAPI: written by `make schemas`. */\n"
    return "\n".join([head, *(declaration(name, schemas[name]) for name in names)])


def within(name: str, schemas: Mapping[str, Any]) -> Iterator[str]:
    """The name of a schema, and of all that are in it."""
    yield name
    parts = [schemas[name]]
    while parts:
        part = parts.pop()
        if isinstance(part, dict):
            parts += part.values()
            if "$ref" in part:
                yield from within(referred(part), schemas)
        elif isinstance(part, list):
            parts += part


def declaration(name: str, schema: Mapping[str, Any]) -> str:
    """A schema as a type, under its description; a document has all of its fields."""
    comment = "\n * ".join(schema.get("description", name).replace("``", "`").splitlines()).replace(
        " * \n", " *\n"
    )
    if "properties" not in schema:
        return f"/** {comment} */\nexport type {short(name)} = {type_of(schema)};\n"
    fields = "".join(
        f"  {field}: {type_of(each)};\n" for field, each in schema["properties"].items()
    )
    return f"/**\n * {comment}\n */\nexport interface {short(name)} {{\n{fields}}}\n"


def type_of(schema: Mapping[str, Any]) -> str:
    """A schema as TypeScript has it."""
    match schema:
        case {"$ref": _}:
            return short(referred(schema))
        case {"anyOf": some}:
            return " | ".join(map(type_of, some))
        case {"enum": words}:
            return " | ".join(map(json.dumps, words))
        case {"prefixItems": parts}:
            return f"[{', '.join(map(type_of, parts))}]"
        case {"items": part}:
            return f"Array<{type_of(part)}>"
        case {"additionalProperties": part}:
            return f"Record<string, {type_of(part)}>"
    if schema["type"] == "integer":
        return "number"
    return str(schema["type"])


def referred(schema: Mapping[str, Any]) -> str:
    """The name of the schema that a reference is to."""
    return str(schema["$ref"].rpartition("/")[2])


def short(name: str) -> str:
    """The name of a schema's type."""
    return name.removesuffix("Schema")


if __name__ == "__main__":
    TYPES.write_text(types())
