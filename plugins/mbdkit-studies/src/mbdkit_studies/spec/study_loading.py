"""Loading of study specs from files, packaged studies and mappings, including their base specs."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any, TypeAlias

from mbdkit.base.errors import SpecError, blaming
from mbdkit.base.plain_data import Path, copied, path_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.items import StudyPlugin
from mbdkit.registry.manager import registry
from mbdkit.spec.loading import example_names, exists, nearest_examples, read_source
from mbdkit.spec.reading import Document, parse_key, read_assignment, read_file, read_text
from mbdkit.spec.schema import schema_with_bases
from mbdkit.spec.spec_kinds import kind_of, packaged_spec, refused, spec_loader, spec_schema
from mbdkit_studies.spec.sample_section import comparable
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_studies.spec.value_sets import sets_together

#: A file, the name of a packaged study, a mapping, or a validated spec.
StudySource: TypeAlias = str | FilePath | Mapping[str, object] | StudySpec


def load_study_spec(source: object, assignments: Iterable[str] = (), *, quick: bool = False) -> StudySpec:
    """Load and validate a study spec; the name or file of each base is replaced by the content, a mapping.

    Parameters
    ----------
    source
        A file (YAML, TOML, JSON), ``"-"`` for standard input, the name of a packaged study, a mapping, a document that
        was read, or a `StudySpec`. The file name of a base is relative to the folder of the study file.
    assignments
        Assignments with values in YAML. Keys of runs, as in ``"time.end=5"``, are set in the base of every run, after
        the `overrides` of the study. Keys of the sample, as in ``"sample.n=64"``, are set in the sample.
    quick
        Whether to load the short form of a packaged study.

    Returns
    -------
    StudySpec
        The validated spec, which is immutable; the specs of its runs are not validated yet.

    Raises
    ------
    SpecError
        If the spec is not valid, with the file, line and key path if known.
    """
    assignments = tuple(assignments)
    given = source if isinstance(source, StudySpec) else None
    if isinstance(source, StudySpec):
        if source._document is not None and not assignments:
            return source
        source = source.model_dump(exclude_unset=True)
    if quick and not (isinstance(source, str) and not os.path.isfile(source) and _has_quick_form(source)):
        raise SpecError("only packaged studies that define a short form have one, such as methods", file="--quick")
    document, folder = document_of(
        source,
        ("study", "studies"),
        lambda name: _packaged_document(name, quick=quick),
        study_names,
        lambda name: registry().advice(name),
    )
    data = document.data
    if "mbdkit" in data and "mbdkit_study" not in data:
        message = "this is a run spec, which `mbdkit run` runs; a study spec begins with `mbdkit_study: 1`"
        raise document.place(SpecError(message, key="mbdkit"))
    if error := refused(data, "study"):
        raise document.place(error)
    with SpecError.place_by(document.place):
        bases = _write_out_bases(data, folder)
        for assignment in assignments:
            _override(document, assignment)
        spec = StudySpec(**data)
    spec._document = document
    spec._bases = bases
    spec._folder = folder
    if given is not None:
        spec._folder, spec._columns = given._folder, given._columns
    return spec


spec_loader(load_study_spec)


def _override(document: Document, assignment: str) -> None:
    """Set a key of the sample, or a key of the base of every run.

    A key of the bases is set in the `overrides` of the study, and in those of each family that has any.
    """
    path, value = read_assignment(assignment)
    if path[0] == "sample":  # not a key of runs
        document.assign(assignment)
        return
    key = path_text(path)
    _check_sample(document.data.get("sample"), path, assignment)
    for place, holder in _holders(document.data).items():
        _check_axes(holder.get("axes"), path, assignment)
        given = holder.get("overrides")
        if (place and not given) or not isinstance(given, Mapping | None):
            continue
        holder["overrides"] = {name: old for name, old in (given or {}).items() if name != key} | {key: value}
        document.overridden[*place, "overrides", key] = assignment


def _check_sample(sample: object, path: Path, assignment: str) -> None:
    """Raise SpecError if a sample sets the key of an assignment, which would have no effect."""
    variables = sample.get("variables") if isinstance(sample, Mapping) else None
    for key in variables if isinstance(variables, Mapping) else ():
        if (drawn := comparable(parse_key(str(key)))) and comparable(path)[: len(drawn)] == drawn:
            message = f"the sample of the study sets {key}, so this would have no effect"
            raise SpecError(message, file=f"--set {assignment}")


def _check_axes(axes: object, path: Path, assignment: str) -> None:
    """Raise SpecError if an axis sets the key of an assignment, which would have no effect."""
    for axis in axes if isinstance(axes, list) else ():
        for name, values in axis.items() if isinstance(axis, Mapping) else ():
            together = sets_together(values) if isinstance(values, list) else []
            for key in [key for _, keys in together for key in keys] if together else [name]:
                if (set_by_axis := parse_key(key)) and path[: len(set_by_axis)] == set_by_axis:
                    message = f"an axis of the study sets {key}, so this would have no effect"
                    raise SpecError(message, file=f"--set {assignment}")


@packaged_spec
def is_study_name(name: str) -> bool:
    """Return whether a name is that of a packaged study, but not of a packaged spec of runs or of inverse dynamics."""
    return name not in {*example_names("run"), *example_names("inverse")} and _packaged(name) is not None


@spec_schema
def study_schema(installed: Registry | None = None) -> dict[str, object]:
    """Return the JSON schema (draft 2020-12) of the study spec; its bases include the schema of the run spec.

    Parameters
    ----------
    installed
        Registry of the models, integrators and force laws to include; by default, all that are installed.
    """
    return schema_with_bases(StudySpec, {"Base": "run"}, installed, holder="Family", units=None)


def study_names() -> list[str]:
    """Return the names of the packaged studies, including those of plugins, as accepted by `load_study_spec`."""
    return sorted(registry().names("study"))


def _packaged(name: str) -> Registered | None:
    """Return the packaged study with this short or full name, or None; raise SpecError if the name is ambiguous."""
    installed = registry()
    known = any(name in (item.name, item.id) for item in installed.of_kind("study"))
    return installed.get("study", name) if known else None


def document_of(
    source: object,
    words: tuple[str, str],
    packaged: Callable[[str], tuple[Document, FilePath] | None],
    names: Callable[[], Sequence[str]],
    advice: Callable[[str], str] = lambda name: "",
) -> tuple[Document, FilePath]:
    """Return the document of a study or design, and the folder to which file names in it are relative.

    Parameters
    ----------
    words
        Words for the source in messages, singular and plural.
    packaged
        Function that returns document and folder of the packaged study or design with a name; None if there is none.
    names
        Function that returns the names of the packaged studies or designs.
    advice
        Function that returns a clause of advice for an error about a name.
    """
    if isinstance(source, Mapping):
        return Document(copied(source)), FilePath()
    if isinstance(source, Document):
        return source, source.folder
    word, many = words
    if not isinstance(source, str | FilePath):
        kinds = f"a file, the name of a packaged {word}, a dict or a {word.title()}Spec"
        raise SpecError(f"a {word} is {kinds}, not {type(source).__name__}")
    if source == "-":
        return read_source("-"), FilePath()
    path = FilePath(source)
    if not os.path.isfile(path) and (document := packaged(str(source))) is not None:
        return document
    if not exists(path):
        raise SpecError(
            f"there is no such file, and no packaged {word} with this name{did_you_mean(str(source), names())}; "
            f"{many}: {listed(names())}{advice(str(source))}",
            file=str(source)[:200],
        )
    return read_file(path), path.parent


def _has_quick_form(name: str) -> bool:
    item = _packaged(name)
    return item is not None and isinstance(item.plugin, StudyPlugin) and callable(item.plugin.spec)


def _packaged_document(name: str, *, quick: bool = False) -> tuple[Document, FilePath] | None:
    """Return the document of a packaged study, and its folder.

    The verdict function of the study is used unless the spec names another one.
    """
    if (item := _packaged(name)) is None:
        return None
    assert isinstance(item.plugin, StudyPlugin)
    path = item.plugin.spec
    if isinstance(path, FilePath):
        document = read_text(path.read_text("utf-8"), f"{item.spec_name} (packaged study)", path.suffix)
    else:
        with blaming(f"{item.id} failed to return its spec", SpecError):
            document, path = Document(copied(path(quick))), FilePath()
    if item.plugin.has_verdict and "verdict" not in document.data:
        document.data["verdict"] = item.spec_name
    return document, path.parent


def _holders(data: dict[str, Any]) -> dict[Path, dict[str, object]]:
    """Return the mappings that may have `base`, `overrides` and `axes`, by key path: the study and its families."""
    families = data.get("families")
    if not isinstance(families, dict):
        return {(): data}
    # copied, because several may be one object in YAML
    copies = {name: dict(family) for name, family in families.items() if isinstance(family, dict)}
    data["families"] = families | copies
    return {(): data} | {("families", name): family for name, family in copies.items()}


def _write_out_bases(data: dict[str, object], folder: FilePath) -> dict[Path, Document]:
    """Replace each base that is a name or a Python object by its data; return the documents of the bases by key
    path.
    """
    documents: dict[Path, Document] = {}
    for path, holder in _holders(data).items():
        if (base := holder.get("base")) is None:
            continue
        document = base_document(base, folder, path_text((*path, "base")), "study")
        holder["base"] = document.data
        if isinstance(base, Mapping):
            continue
        documents[*path, "base"] = document
        if (kind := kind_of(document.data)).run_kind not in ("forward", ""):
            message = f"this is {kind.phrase}; the base of a study is a run spec"
            raise document.place(SpecError(message, key=kind.marker))
    return documents


def base_document(base: object, folder: FilePath, key: str, owner: str) -> Document:
    """Return the document of a base: of a mapping, of a Python object, or of `base_source` for a name.

    Raises
    ------
    SpecError
        If there is no such file or example, or if the parameters cannot be taken from the file that the base names.
    """
    if not isinstance(base, Mapping):
        return read_source(base_source(base, folder, key, owner) if isinstance(base, str) else base)
    with SpecError.locate(key):
        return read_source(Document(copied(base), folder=folder))


def base_source(base: str, folder: FilePath, key: str, owner: str) -> str | FilePath:
    """Return a source for `read_source`: the path of a file in the folder of its owner, or the name of an example.

    Parameters
    ----------
    owner
        ``study`` or ``design``, for error messages.
    """
    path = folder / base
    names = [*example_names("run"), *example_names("inverse")]
    if os.path.isfile(path) or base not in names:
        if base == "-" or not exists(path):
            raise SpecError(
                f"there is no file '{base}' in the folder of the {owner}, and no packaged example with this "
                f"name{nearest_examples(base, names)}",
                key=key,
            )
        return path
    return base
