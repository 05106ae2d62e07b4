"""A block of the spec: a pydantic model read so that every mistake in it becomes a Problem with its place."""

from __future__ import annotations

import keyword
import re
import typing
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError

from cdobs_cli.errors import Problem
from cdobs_cli.exact.parser import CONSTANTS, TYPED_FUNCTIONS, nearest
from cdobs_cli.fields import wrong
from cdobs_cli.spec.reader import DecimalText, Document, FieldPath, shown

RESERVED = frozenset({*CONSTANTS, *TYPED_FUNCTIONS, "t", "t_k", "elapsed", "uniform", "normal", "inf", "nan"})
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,31}\Z", re.ASCII)


def is_identifier(name: str) -> bool:
    """Whether a name can stand in an expression, reserved or not."""
    return _IDENTIFIER.match(name) is not None and not keyword.iskeyword(name)


def _identifier(name: str) -> str:
    if not _IDENTIFIER.match(name):
        raise wrong("a name is a letter followed by letters, digits and _, at most 32 in all")
    if name in RESERVED or keyword.iskeyword(name):
        raise wrong(f"the name {name} is reserved")
    return name


def _text(value: Any) -> Any:
    if isinstance(value, DecimalText):
        raise wrong("text is expected, put it in quotes")
    return value


Text = Annotated[str, BeforeValidator(_text)]
Name = Annotated[str, AfterValidator(_identifier)]


def unknown_key(at: FieldPath, name: str, allowed: list[str]) -> Problem:
    """A key is quoted by its name, whatever its value."""
    return Problem((*at, name), "unknown key", None, ", ".join(allowed), nearest(name, allowed)[2:] or None)


class Block(BaseModel):
    """Base of the blocks. Fields that must be there are named in `required` and default to None, so that what
    is right in a block can be checked further when something else in it is wrong."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)
    required: ClassVar[tuple[str, ...]] = ()


B = TypeVar("B", bound=BaseModel)


def read_block(
    model: type[B], value: Any, at: FieldPath, context: dict[str, Any]
) -> tuple[B | None, set[str], list[Problem]]:
    """The block with the fields that are right, the names of those that are wrong, and the problems.

    The block is None where the value is no mapping, or nothing can be made of it.
    """
    if not isinstance(value, dict):
        return None, set(), [Problem(at, "a mapping is expected", shown(value), ", ".join(model.model_fields))]
    problems: list[Problem] = []
    wrong_fields: set[str] = set()
    try:
        block: B | None = model.model_validate(value, context=context)
    except ValidationError as error:
        problems = explain(error, model, value, at)
        wrong_fields = {str(item["loc"][0]) for item in error.errors(include_url=False) if item["loc"]}
        block = _partial(model, {name: entry for name, entry in value.items() if name not in wrong_fields}, context)
    for name in getattr(model, "required", ()):
        if value.get(name) is None and name not in wrong_fields:
            problems.append(Problem((*at, name), "is required"))
            wrong_fields.add(name)
    return block, wrong_fields, problems


def _partial(model: type[B], value: dict[str, Any], context: dict[str, Any]) -> B | None:
    try:
        return model.model_validate(value, context=context)
    except ValidationError:
        return None


def explain(error: ValidationError, model: type[BaseModel], value: Any, at: FieldPath) -> list[Problem]:
    """Pydantic's errors as Problems, in the words of this tool."""
    problems = []
    for item in error.errors(include_url=False):
        path, inner = _walk(value, item["loc"])
        kind, context = item["type"], item.get("ctx", {})
        problem = Problem((*at, *path), _sentence(kind, item["msg"], context), shown(inner), hint=context.get("hint"))
        if kind == "extra_forbidden":
            problem = unknown_key(problem.field[:-1], str(item["loc"][-1]), sorted(_allowed(model, item["loc"][:-1])))
        elif kind == "missing":
            problem = Problem((*at, *path, *item["loc"][-1:]), "is required")
        elif kind in ("literal_error", "union_tag_invalid", "enum"):
            expected = str(context.get("expected") or context.get("expected_tags"))
            hint = nearest(str(inner), expected.replace("'", "").replace(" or ", ", ").split(", "))[2:] or None
            problem = replace(problem, allowed=expected.replace("'", ""), hint=hint)
        elif kind == "string_type" and isinstance(inner, int):
            problem = replace(problem, hint="put it in quotes")
        problems.append(problem)
    return problems


_SENTENCES = {
    "literal_error": "one of a few values is expected", "union_tag_invalid": "one of a few names is expected",
    "string_type": "text is expected",
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type", "mapping_type"), "a mapping is expected"),
    **dict.fromkeys(("tuple_type", "list_type"), "a list is expected"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false is expected"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float", "int_parsing_size"), "an integer is expected"),
}  # fmt: skip


def _sentence(kind: str, message: str, context: dict[str, Any]) -> str:
    if kind == "value":
        return str(context["what"])
    text = _SENTENCES.get(kind) or message.removeprefix("Value error, ")
    return text[:1].lower() + text[1:]


def _walk(value: Any, loc: tuple[str | int, ...]) -> tuple[FieldPath, Any]:
    """The typed path behind pydantic's, which also names the members of unions; and what stands there."""
    path: list[str | int] = []
    for part in loc:
        inside = isinstance(value, list) and isinstance(part, int) and part < len(value)
        if inside or (isinstance(value, dict) and part in value):
            value = value[part]
            path.append(part)
    return tuple(path), value


def _allowed(model: type[BaseModel], loc: tuple[str | int, ...]) -> set[str]:
    """Names of the keys that the model at `loc` takes."""
    candidates = {model}
    for part in loc:
        fields = [one.model_fields[str(part)] for one in candidates if part in one.model_fields]
        candidates = {model for field in fields for model in _models(field.annotation)} or candidates
    return {name for candidate in candidates for name in candidate.model_fields}


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    stack = [annotation]
    while stack:
        current = stack.pop()
        if isinstance(current, type) and issubclass(current, BaseModel):
            yield current
        stack.extend(typing.get_args(current))


def placed(problem: Problem, document: Document) -> Problem:
    """The problem with its file, line and column; unknown keys are placed at the key itself."""
    if problem.line is not None:
        return problem
    place = document.place(problem.field, key=problem.what in ("unknown key",) or problem.what.startswith("the name"))
    return replace(problem, file=place.file, line=place.line, column=place.column)
