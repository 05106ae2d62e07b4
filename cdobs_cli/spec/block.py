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
from cdobs_cli.fields import as_rows, wrong
from cdobs_cli.labels import SECONDS
from cdobs_cli.spec.elsewhere import Typed, as_block, word_for
from cdobs_cli.spec.reader import LONGEST_FLOW, DecimalText, Document, FieldPath, flow, shown

Loc = tuple[str | int, ...]
REQUIRED = "is required"
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


def unknown_key(at: FieldPath, name: str, allowed: list[str], typed: Typed | None = None) -> Problem:
    """A key is quoted by its name; its value in what to write for it."""
    return _unknown(at, name, allowed, typed or Typed(None))[0]


def _unknown(at: FieldPath, name: str, allowed: list[str], typed: Typed) -> tuple[Problem, str]:
    """The problem, and the key of the block that is meant; empty where none is."""
    known = word_for(at, name, typed, allowed)
    meant, hint = known or ("", nearest(name, allowed)[2:] or None)
    key, colon, value = name.partition(":")
    if typed.value is None and colon and key.strip() in allowed:
        meant, hint = key.strip(), f"write a space behind the colon: {key.strip()}: {value[:LONGEST_FLOW]}"
    elif known is None and hint is not None:
        meant = hint.split("'")[1]
    if hint is None and typed.value is None and name.isdigit():
        hint = "a decimal point is written '.'"
    return Problem((*at, name), "unknown key", None, ", ".join(allowed), hint), meant


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
        problems, meant = explain(error, model, value, at, context.get("time_unit") or SECONDS)
        wrong_fields = {str(item["loc"][0]) for item in error.errors(include_url=False) if item["loc"]}
        block = _partial(model, {name: entry for name, entry in value.items() if name not in wrong_fields}, context)
        # What another word was typed for is not missing.
        wrong_fields |= {str(path[-1]) for path in meant if path[:-1] == at and path[-1] not in value}
    for name in getattr(model, "required", ()):
        if value.get(name) is None and name not in wrong_fields:
            problems.append(Problem((*at, name), REQUIRED))
            wrong_fields.add(name)
    return block, wrong_fields, problems


def _partial(model: type[B], value: dict[str, Any], context: dict[str, Any]) -> B | None:
    try:
        return model.model_validate(value, context=context)
    except ValidationError:
        return None


def explain(
    error: ValidationError, model: type[BaseModel], value: Any, at: FieldPath, time_unit: str = SECONDS
) -> tuple[list[Problem], set[FieldPath]]:
    """Pydantic's errors as Problems, in the words of this tool, each mistake once; and the keys for which others were
    typed: these are not missing. time_unit: of numbers in what is to be written."""
    items = error.errors(include_url=False)
    problems, meant = [], set[FieldPath]()
    for item in items:
        if item["type"] == "extra_forbidden":
            problem, key = _unknown_of(item["loc"], model, value, at, time_unit)
            meant |= {(*problem.field[:-1], key)} if key else set()
        else:
            problem = _problem(item, model, value, at, time_unit)
        problems.append(problem)
    # Another word may stand for another of its keys: max_interval where only a period was missed.
    around = {path[:-1] for path in meant}
    return [one for one in problems if one.what != REQUIRED or one.field[:-1] not in around], meant


def _unknown_of(loc: Loc, model: type[BaseModel], value: Any, at: FieldPath, time_unit: str) -> tuple[Problem, str]:
    path, around = _walk(value, loc[:-1])
    name, allowed = str(loc[-1]), sorted(_allowed(model, loc[:-1]))
    typed = around.get(name) if isinstance(around, dict) else None
    if path and path[-1] == "gain" and name.isalpha() and (letters := _required(model, loc[:-1])):
        problem = Problem((*at, *path, name), "unknown key", None, ", ".join(allowed), _letter(model, letters, typed))
        return problem, letters[0]
    return _unknown((*at, *path), name, allowed, Typed(typed, around, time_unit))


def _letter(model: type[BaseModel], letters: list[str], typed: Any) -> str:
    """What the gain of a family is called."""
    family = model.model_fields["family"].default
    written = ", ".join([f"{letters[0]}: {flow(typed) or '..'}", *(f"{letter}: .." for letter in letters[1:])])
    sense = _SENSES.get(family, "")
    return f"the gain of {family} is {' and '.join(letters)}{sense}: write gain: {{{written}}}"


def _problem(item: Any, model: type[BaseModel], value: Any, at: FieldPath, time_unit: str) -> Problem:
    path, inner = _walk(value, item["loc"])
    kind, context, field = item["type"], item.get("ctx", {}), (*at, *path)
    problem = Problem(field, _sentence(kind, item["msg"], context), shown(inner), hint=context.get("hint"))
    if kind == "missing":
        return Problem((*field, *item["loc"][-1:]), REQUIRED)
    if kind in ("literal_error", "union_tag_invalid", "enum"):
        expected = str(context.get("expected") or context.get("expected_tags")).replace("'", "")
        hint = nearest(str(inner), expected.replace(" or ", ", ").split(", "))[2:] or None
        return replace(problem, allowed=_YAML_WORDS.get(expected, expected), hint=hint)
    if kind == "string_type" and isinstance(inner, int):
        return replace(problem, hint="put it in quotes")
    if kind in _NO_MAPPING and not isinstance(inner, dict):
        hint = as_block(field, Typed(inner, None, time_unit)) or _only_key(model, item["loc"], field, inner)
        return replace(problem, hint=hint)
    if kind in _NO_LIST and field and isinstance(field[-1], str) and isinstance(inner, int | str):
        return replace(problem, hint=f"write {field[-1]}: [{shown(inner)}]")
    if kind in _NO_LIST and field and isinstance(field[-1], str) and isinstance(inner, dict):
        return replace(problem, hint=f"write {field[-1]}: [..], the entries in their order, without names")
    return problem


def _only_key(model: type[BaseModel], loc: Loc, field: FieldPath, inner: Any) -> str | None:
    """What to write for the value of a block's first required key that stands in the block's place."""
    required = _required(model, loc)
    if not required or not field:
        return None
    flat = isinstance(inner, list) and inner and not any(isinstance(one, list | dict) for one in inner)
    text = as_rows(required[0], inner) if flat else flow(inner)
    if text is None:
        return None
    written = ", ".join([f"{required[0]}: {text}", *(f"{name}: .." for name in required[1:])])
    return f"write {field[-1]}: {{{written}}}"


def _required(model: type[BaseModel], loc: Loc) -> list[str]:
    """The keys that the model at `loc` must have."""
    named = [one for one in _candidates(model, loc) if one is not model]
    return [name for one in named[:1] for name, field in one.model_fields.items() if field.is_required()]


# A gain by another letter is another gain: where the other is at home.
_SENSES = {
    "lpv_zoh": ", held from sample to sample (a K that jumps at samples is of family reachability)",
    "reachability": ", a jump at samples (an L held from sample to sample is of family lpv_zoh)",
}
_NO_MAPPING = frozenset({"dict_type", "model_type", "model_attributes_type", "mapping_type"})
_NO_LIST = frozenset({"tuple_type", "list_type"})
_YAML_WORDS = {"True": "true", "False": "false"}
_SENTENCES = {
    "literal_error": "one of a few values is expected", "union_tag_invalid": "one of a few names is expected",
    "string_type": "text is expected",
    **dict.fromkeys(_NO_MAPPING, "a mapping is expected"), **dict.fromkeys(_NO_LIST, "a list is expected"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false is expected"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float", "int_parsing_size"), "an integer is expected"),
    "greater_than_equal": "a number of at least {ge} is expected", "greater_than": "a number above {gt} is expected",
    "less_than_equal": "a number of at most {le} is expected", "less_than": "a number below {lt} is expected",
    "string_too_long": "text of at most {max_length} characters is expected",
    "string_too_short": "text of at least {min_length} characters is expected",
    "too_long": "a list of at most {max_length} entries is expected",
    "too_short": "a list of at least {min_length} entries is expected",
}  # fmt: skip


def _sentence(kind: str, message: str, context: dict[str, Any]) -> str:
    if kind == "value":
        return str(context["what"])
    if kind in _SENTENCES:
        return _SENTENCES[kind].format_map(context)
    text = message.removeprefix("Value error, ")
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


def _allowed(model: type[BaseModel], loc: Loc) -> set[str]:
    """Names of the keys that the model at `loc` takes."""
    return {name for candidate in _candidates(model, loc) for name in candidate.model_fields}


def _candidates(model: type[BaseModel], loc: Loc) -> list[type[BaseModel]]:
    """The models that may stand at `loc`."""
    candidates = [model]
    for part in loc:
        fields = [one.model_fields[str(part)] for one in candidates if part in one.model_fields]
        candidates = [model for field in fields for model in _models(field.annotation)] or candidates
    return candidates


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
