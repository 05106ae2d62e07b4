"""A unit of FMI 2.0 for co-simulation: the observer in C99, its description, and a library of this machine."""

from __future__ import annotations

import hashlib
import io
import platform
import sys
import zipfile
from collections.abc import Iterator, Mapping
from importlib.resources import files
from xml.etree import ElementTree

from cdobs_cli.errors import UsageError
from cdobs_cli.export.about import About
from cdobs_cli.export.c99_test import c99_files
from cdobs_cli.export.portable import Portable
from cdobs_cli.export.vectors import Vectors
from cdobs_cli.library import compiled
from cdobs_cli.printable import printable
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

_WRAPPER = "fmu.c"
_SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("win", ".dll")}
_EPOCH = (1980, 1, 1, 0, 0, 0)  # equal files for equal designs


@dataclass(frozen=True)
class _Variable:
    name: str
    causality: str
    variability: str
    start: float | None
    description: str


def fmu_bytes(portable: Portable, about: About, told: Vectors | None, law: SamplingLaw) -> bytes:
    """The unit, a zip file. Where the machine has no C compiler it holds sources alone.

    Raises: UsageError where samples are not all alike, or the observer has inputs of its own to set.
    """
    if len(portable.corrections) > 1 or portable.late or portable.trigger is not None or portable.compares:
        what = "a unit of FMI has one period and one kind of sample"
        raise UsageError(f"{what}, this observer is sampled {about.law}; write --to c99")
    if portable.control:
        raise UsageError("a unit of FMI has no inputs that the observer sets; write --to c99")
    period, variables = float(law.period), list(_variables(portable, told, float(law.period)))
    source = _source(portable, about, told, variables)
    guid = hashlib.sha256(source.encode()).hexdigest()[:32]
    name = portable.name
    held = {
        "modelDescription.xml": _description(portable, about, variables, period, guid),
        f"sources/{name}_fmu.c": source.encode("ascii"),
    }
    library = compiled(source)
    if library is not None and sys.platform in _SYSTEMS:
        system, ending = _SYSTEMS[sys.platform]
        bits = platform.architecture()[0].removesuffix("bit")
        held[f"binaries/{system}{bits}/{name}{ending}"] = library.read_bytes()
    return _packed(held)


def _packed(held: Mapping[str, bytes]) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for file, content in held.items():
            archive.writestr(zipfile.ZipInfo(file, _EPOCH), content, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def _variables(portable: Portable, told: Vectors | None, period: float) -> Iterator[_Variable]:
    """In the order of their numbers: outputs of the plant, its inputs, the start, the estimate, the period."""
    for k in range(portable.outputs):
        yield _Variable(f"y{k + 1}", "input", "discrete", 0.0, f"output {k + 1}, read when a sample is due")
    for name in portable.inputs:
        yield _Variable(f"input.{name}", "input", "continuous", 0.0, f"{name}, held over a step")
    given = iter(() if told is None else told.start)
    for kind in _starts(portable):
        for state in portable.plant_states:
            yield _Variable(f"initial.{kind}{state}", "parameter", "fixed", next(given, 0.0), f"{state} at the start")
    for word, rows in portable.estimates.items():
        for state, _ in zip(portable.plant_states, rows, strict=True):
            yield _Variable(f"{word}.{state}", "output", "continuous", None, f"estimate of {state}")
    yield _Variable("period", "parameter", "fixed", period, "from one sample to the next")


def _starts(portable: Portable) -> tuple[str, ...]:
    return ("lower.", "upper.") if portable.starts_from_box else ("",)


def _source(portable: Portable, about: About, told: Vectors | None, variables: list[_Variable]) -> str:
    """One file: header and source of the observer, then the functions of FMI."""
    name, n = portable.name, len(portable.plant_states)
    texts = c99_files(portable, about, told)
    own = texts[f"{name}.c"].replace(f'#include "{name}.h"\n', "")
    p, m = portable.outputs, len(portable.inputs)
    first_start, first_told = p + m, p + m + n * len(_starts(portable))
    u = ", {}" if m else ""
    starts = ", ".join(f"(v) + {first_start + n * k}" for k in range(len(_starts(portable))))
    shown = " ".join(f"{name}_{word}(s, (v) + {first_told + n * k});" for k, word in enumerate(portable.estimates))
    macros = {
        "COUNT": len(variables), "FIRST_OUTPUT": 0, "FIRST_INPUT": p, "INPUTS": m, "PERIOD": len(variables) - 1,
        "FIRST_SAMPLE": 0 if portable.first_sample else 1,
        "DEFAULTS": ", ".join(repr(one.start or 0.0) for one in variables),
        "BEGIN(s, v)": f"{name}_init(s, {starts});",
        "TELL(s, v)": shown,
        "CORRECT(s, y, u)": f"{name}_correct(s, y{u.format('u')});",
        "PREDICT(s, dt, u)": f"{name}_predict(s, dt{u.format('u')});",
    }  # fmt: skip
    defined = "\n".join(f"#define {key} {value}" for key, value in macros.items())
    wrapper = files(__package__).joinpath(_WRAPPER).read_text(encoding="ascii").replace("NAME_state", f"{name}_state")
    text = f"{texts[f'{name}.h']}\n{own}\n{defined}\n\n{wrapper}"
    return text.encode("ascii", "backslashreplace").decode()  # comments quote what the user typed


def _description(portable: Portable, about: About, variables: list[_Variable], period: float, guid: str) -> bytes:
    """modelDescription.xml."""
    root = ElementTree.Element("fmiModelDescription", {
        "fmiVersion": "2.0", "modelName": portable.name, "guid": f"{{{guid}}}",
        "description": printable(" ".join((f"{about.title}. Verdict: {about.verdict}.", *about.told))),
        "generationTool": "cdobs", "variableNamingConvention": "structured", "numberOfEventIndicators": "0",
    })  # fmt: skip
    unit = ElementTree.SubElement(root, "CoSimulation", {
        "modelIdentifier": portable.name, "canHandleVariableCommunicationStepSize": "true",
        "canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true",
    })  # fmt: skip
    ElementTree.SubElement(ElementTree.SubElement(unit, "SourceFiles"), "File", {"name": f"{portable.name}_fmu.c"})
    ElementTree.SubElement(root, "DefaultExperiment", {"startTime": "0", "stepSize": repr(period)})
    listed = ElementTree.SubElement(root, "ModelVariables")
    for number, one in enumerate(variables):
        told = {"initial": "calculated"} if one.start is None else {}
        told |= {"initial": "exact"} if one.causality == "parameter" else {}
        scalar = ElementTree.SubElement(listed, "ScalarVariable", {
            "name": one.name, "valueReference": str(number), "description": one.description,
            "causality": one.causality, "variability": one.variability, **told,
        })  # fmt: skip
        ElementTree.SubElement(scalar, "Real", {} if one.start is None else {"start": repr(one.start)})
    structure = ElementTree.SubElement(root, "ModelStructure")
    for kind in ("Outputs", "InitialUnknowns"):
        part = ElementTree.SubElement(structure, kind)
        for number, one in enumerate(variables, start=1):
            if one.causality == "output":
                ElementTree.SubElement(part, "Unknown", {"index": str(number)})
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text
