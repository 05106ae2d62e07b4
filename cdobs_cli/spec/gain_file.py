"""`gain: {file: design.mat}`: a gain that another tool designed, its matrices as decimals in the place of the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.families import FAMILIES
from cdobs_cli.regular import IrregularError, regular_bytes
from cdobs_cli.spec.matlab import MatlabError, Matrix, real_matrices
from cdobs_cli.spec.plant_file import name_refusal
from cdobs_cli.spec.reader import DecimalText, FieldPath, shown

MAX_BYTES = 256 * 1024
_KEYS = ("file", "variables")
_AT: FieldPath = ("observer", "gain")


def letters_of(family: object) -> tuple[str, ...]:
    """What the gain of a family is made of; nothing where there is no such family, or it takes no gain."""
    model = FAMILIES.get(family) if isinstance(family, str) else None
    gain = None if model is None else model.model_fields.get("gain")
    blocks = () if gain is None else (one for one in get_args(gain.annotation) if isinstance(one, type))
    return tuple(letter for one in blocks if issubclass(one, BaseModel) for letter in one.model_fields)


def gain_of_file(spec: Path, typed: Mapping[str, Any], letters: Sequence[str]) -> dict[str, Any]:
    """The gain by letters, of those variables of the file that have these names, or the names typed in `variables`:
    capital letters are matrices (rows of decimals), small ones numbers.

    Raises:
        SpecError: the file may not be meant or cannot be read, or a matrix is not as it must be.
    """
    name, named = typed["file"], typed.get("variables") or {}
    problems = [Problem((*_AT, key), "unknown key", allowed=", ".join(_KEYS), hint="`file` stands alone")
                for key in typed if key not in _KEYS]  # fmt: skip
    if not isinstance(name, str) or not name:
        problems.append(Problem((*_AT, "file"), "a file name is expected", shown(name)))
    if not isinstance(named, dict) or not all(isinstance(one, str) for one in named.values()):
        problems.append(Problem((*_AT, "variables"), "names of variables are expected", shown(named),
                                f"a mapping from {', '.join(letters)} to names"))  # fmt: skip
    elif unknown := [letter for letter in named if letter not in letters]:
        problems.append(Problem((*_AT, "variables", unknown[0]), "unknown name", allowed=", ".join(letters)))
    if not problems and (refusal := name_refusal(spec, name, "a gain's file", "a MATLAB file", (".mat",))):
        problems.append(Problem((*_AT, "file"), refusal.what, refusal.got, refusal.allowed, refusal.hint))
    if problems:
        raise SpecError(tuple(problems))
    found = _variables(spec.parent / name, name)
    gain = {}
    for letter in letters:
        variable = named.get(letter, letter)
        if variable in found:
            gain[letter] = _decimals(found[variable], letter, variable)
        elif letter in named:
            raise SpecError.at((*_AT, "variables", letter), "the file has no such real matrix", variable,
                               ", ".join(sorted(found)) or "nothing: the file has no variable")  # fmt: skip
    if not gain:
        has = f"; it has {', '.join(sorted(found))}" if found else ""
        hint = f"name them: variables: {{{letters[0]}: ..}}"
        raise SpecError.at((*_AT, "file"), f"the file has no real matrix {' or '.join(letters)}{has}", hint=hint)
    return gain


def _variables(path: Path, name: str) -> dict[str, Matrix]:
    """The matrices of the file. Raises: SpecError."""
    try:
        data = regular_bytes(path, MAX_BYTES)
    except (OSError, ValueError) as error:
        why = str(error) if isinstance(error, IrregularError) else getattr(error, "strerror", None) or "no such file"
        raise SpecError.at((*_AT, "file"), f"the file cannot be read: {why}", shown(name)) from None
    if len(data) > MAX_BYTES:
        raise SpecError.at((*_AT, "file"), "the file is too long", shown(name), f"at most {MAX_BYTES // 1024} KiB")
    try:
        return real_matrices(data)
    except MatlabError as error:
        raise SpecError.at((*_AT, "file"), str(error), shown(name)) from None


def _decimals(value: Matrix, letter: str, variable: str) -> Any:
    """Raises: SpecError."""
    if not all(isfinite(entry) for row in value for entry in row):
        raise SpecError.at((*_AT, "file"), f"the matrix {variable} has entries that are no finite numbers")
    rows = [[DecimalText(repr(entry)) for entry in row] for row in value]
    if letter.islower():
        if (len(rows), len(rows[0])) != (1, 1):
            raise SpecError.at((*_AT, "file"), f"the variable {variable} is a matrix, {letter} a number")
        return rows[0][0]
    return rows
