"""Archives for catalogues: folders in the format of a Process Run Crate, a profile of RO-Crate.

https://w3id.org/ro/crate/1.1 and https://w3id.org/ro/wfrun/process/0.5 define the entities and their properties.
"""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from mbdkit.archive.archive_check import check
from mbdkit.archive.fingerprint import seal
from mbdkit.archive.layout import EVIDENCE
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.skeleton import memory_file
from mbdkit.base.errors import SpecError, file_error
from mbdkit.base.files import check_output
from mbdkit.base.plain_data import json_text
from mbdkit.base.text import shown
from mbdkit.plugin.seams import file_problems
from mbdkit.registry.manager import registry
from mbdkit.runs.method_evidence import FORMAT, FORMAT_VERSION, code_digest, evidence_file, read_records
from mbdkit_report.pages.report import write_report

METADATA = "ro-crate-metadata.json"
#: Attributes of the provenance that tell about the machine or the user; copies in a crate lack them.
OF_MACHINE = ("command", "cpu_count", "platform", "processor", "resumed_by")
_PROCESS = "https://w3id.org/ro/wfrun/process/0.5"
_CONTEXT = ["https://w3id.org/ro/crate/1.1/context", {"sha256": "https://w3id.org/ro/terms/workflow-run#sha256"}]
#: Media type of a file by its suffix, and the page that defines it.
_FORMATS = {
    ".h5": ("application/x-hdf5", "https://www.nationalarchives.gov.uk/PRONOM/fmt/807"),
    ".json": ("application/json", "https://www.nationalarchives.gov.uk/PRONOM/fmt/817"),
    ".html": ("text/html", "https://www.nationalarchives.gov.uk/PRONOM/fmt/471"),
    ".bib": ("application/x-bibtex", "http://www.bibtex.org/Format/"),
}
#: Addresses of software that states none; nothing exists in the domain ``invalid``.
_NOWHERE = "https://python-package.invalid"
_MBDKIT = "https://github.com/mbdkit/mbdkit"
_UNNAMED = {"@id": "#unnamed", "@type": "Organization", "name": "not stated", "url": f"{_NOWHERE}/not-stated"}

Entity = dict[str, Any]


def write_crate(archives: Sequence[Path], folder: Path) -> None:
    """Write a crate of archives: copies of them, their specs, reports with figures, evidence of methods, and citations.

    Parameters
    ----------
    folder
        The new folder.

    Raises
    ------
    SpecError
        If the folder exists, two archives have one name, an archive is damaged, or a run has not ended.
    ResourceError
        If the disk is full or writing is not permitted.
    """
    check_output(folder, overwrite=False)
    names = [path.stem for path in archives]
    if len({*names}) < len(names):
        raise SpecError("two archives have the same name; rename one", file=archives[0])
    for path in archives:
        with load(path) as run:
            if run.status == "running":
                raise SpecError("this run did not end", file=path)
        if problems := check(path):  # a copy gets hashes of its own, which would hide changes
            raise SpecError(f"this archive is damaged: {problems[0]}", file=path)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as work:
            crate = _Crate(Path(work) / folder.name)
            crate.folder.mkdir()
            for path in archives:
                crate.add_run(path)
            crate.write(archives)
            crate.folder.rename(folder)
    except OSError as error:
        raise file_error(
            error.errno, f"this folder cannot be written: {error.strerror or error}", file=folder
        ) from error


class _Crate:
    """The entities of a crate, by their identifiers, and the folder with their files."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.entities: dict[str, Entity] = {}
        self.references: dict[str, None] = {}
        self.root: Entity = {}

    def add(self, entity: Entity) -> Entity:
        """Add an entity, and return a reference to it."""
        self.entities[entity["@id"]] = entity
        return {"@id": entity["@id"]}

    def add_file(self, name: str, content: bytes | None, what: str, **further: object) -> Entity:
        """Add a file, which is written if there is content, and return a reference to it."""
        path = self.folder / name
        if content is not None:
            path.write_bytes(content)
        content = path.read_bytes()
        media_type, page = _FORMATS[path.suffix]
        kind = self.add({"@id": page, "@type": "WebSite", "name": media_type})
        entity: Entity = {"@id": name, "@type": "File", "name": what, "encodingFormat": [media_type, kind]}
        entity |= {"contentSize": str(len(content)), "sha256": hashlib.sha256(content).hexdigest(), **further}
        return self.add(entity)

    def add_run(self, path: Path) -> None:
        """Add the files of an archive, and the action that made it."""
        stem = path.stem
        target = self.folder / f"{stem}.h5"
        target.write_bytes(_without_machine(path))
        write_report(target, self.folder / f"{stem}.html")
        with load(target) as run:
            texts = {name: str(run.file.attrs.get(name, "")) for name in ("title", "description", "creator", "license")}
            spec = self.add_file(f"{stem}-spec.json", json_text(run.spec).encode(), f"spec of {stem}")
            archive = self.add_file(
                target.name, None, texts["title"], description=texts["description"], identifier=run.data_sha256
            )
            page = self.add_file(f"{stem}.html", None, f"report of {stem}, with figures")
            instruments = [self.add(one) for one in _software(run)]
            evidence = [
                self.add_file(f"{stem}-evidence.json", text, f"evidence of {name}") for name, text in _evidence(run)
            ]
            self.references |= dict.fromkeys(_references(run))
            begin = datetime.fromisoformat(run.created_utc)
            end = begin + timedelta(seconds=float(sum(run.stats.get(key, 0.0) for key in ("setup_s", "wall_s"))))
            is_failed = run.status == "failed"
            action: Entity = {
                "@id": f"#run-{run.run_id}-{stem}", "@type": "CreateAction", "name": f"run of {stem}",
                "description": f"{texts['description']} Verdict: {run.verdict}. {run.provenance.get(EVIDENCE, '')}",
                "instrument": instruments, "object": [spec, *evidence], "result": [archive, page],
                "startTime": _time(begin), "endTime": _time(end),
                "actionStatus": f"http://schema.org/{'Failed' if is_failed else 'Completed'}ActionStatus",
                **({"error": run.status_reason} if is_failed else {}),
            }  # fmt: skip
        action["agent"] = self.add(_creator(texts["creator"]))
        self.root = self.root or {**texts, "mentions": [], "dates": []}
        self.root["mentions"].append(self.add(action))
        self.root["dates"].append(_time(begin))

    def write(self, archives: Sequence[Path]) -> None:
        """Add citations, and write the metadata of the crate."""
        own = f"@software{{mbdkit, author = {{{{The mbdkit authors}}}}, title = {{mbdkit}}, url = {{{_MBDKIT}}}}}"
        codemeta = Path(__file__).with_name("codemeta.json").read_bytes()
        self.add_file("codemeta.json", codemeta, "description of mbdkit (CodeMeta)")
        self.add_file("citation.bib", "\n\n".join([own, *self.references, ""]).encode(), "references (BibTeX)")
        files = [{"@id": name} for name, entity in self.entities.items() if entity["@type"] == "File"]
        nobody, texts = self.add(_UNNAMED), self.root
        more = f", and {len(archives) - 1} more" if len(archives) > 1 else ""
        profile = self.add({"@id": _PROCESS, "@type": "CreativeWork", "name": "Process Run Crate", "version": "0.5"})
        root = {
            "@id": "./", "@type": "Dataset", "name": texts["title"] + more, "description": texts["description"],
            "datePublished": max(texts["dates"]), "license": self.add(_license(texts["license"])),
            "author": self.add(_creator(texts["creator"])), "publisher": nobody, "conformsTo": profile,
            "hasPart": files, "mentions": texts["mentions"],
        }  # fmt: skip
        about = {"about": {"@id": "./"}, "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"}}
        graph = [{"@id": METADATA, "@type": "CreativeWork", **about}, root, *self.entities.values()]
        for entity in graph:  # the specification asks for the one item of a list
            entity.update({key: x[0] for key, x in entity.items() if isinstance(x, list) and len(x) == 1})
        text = json.dumps({"@context": _CONTEXT, "@graph": graph}, indent=1, ensure_ascii=False)
        (self.folder / METADATA).write_text(f"{text}\n", encoding="utf-8", newline="\n")


def _time(time: datetime) -> str:
    return time.isoformat(timespec="milliseconds")


def _without_machine(path: Path) -> bytes:
    """Return the content of an archive without what it tells about the machine and the user."""
    with memory_file(path.read_bytes()) as file:
        texts = [file["provenance"].attrs.pop(name, "") for name in OF_MACHINE]
        seal(file)
        file.flush()
        image = bytes(file.id.get_file_image())
    for text in (text.encode() for text in texts if isinstance(text, str) and text):
        image = image.replace(text, b" " * len(text))  # HDF5 leaves the bytes of what it deletes
    return image


def _software(run: Run) -> Iterator[Entity]:
    """Yield mbdkit and the other distributions of a run."""
    known = {"mbdkit": str(run.provenance.get("mbdkit", "unknown"))}
    for key in run.provenance:
        if key.endswith("_distribution"):
            names, versions = (
                str(run.provenance.get(name, "")).split(", ")
                for name in (key, key.replace("_distribution", "_version"))
            )
            known |= dict(zip(names, versions, strict=False))
    for name, version in known.items():
        page = _MBDKIT if name == "mbdkit" else f"{_NOWHERE}/{name}"
        identifier = f"{page}/{version}" if name != "mbdkit" else f"{page}/releases/tag/v{version}"
        entity = {"@id": identifier, "@type": "SoftwareApplication", "name": name, "url": page}
        yield entity | {"softwareVersion": version}


def _evidence(run: Run) -> Iterator[tuple[str, bytes]]:
    """Yield name and evidence of the integrator if it is installed with the code that the run used."""
    for item in registry().of_kind("integrator"):
        digest = run.provenance.get("integrator_digest")
        if item.id == run.provenance.get("integrator") and code_digest(item.origin) == digest:
            with suppress(ValueError):  # damaged evidence is none
                records = [one for one in read_records(evidence_file(item.origin)) if one["name"] == item.name]
                if records:
                    data = {"format": FORMAT, "format_version": FORMAT_VERSION, "records": records}
                    yield item.id, json_text(data).encode()


def _references(run: Run) -> Sequence[str]:
    names = [str(run.provenance.get(kind, "")) for kind in ("integrator", "model")]
    items = [item for kind in ("integrator", "model") for item in registry().of_kind(kind) if item.id in names]
    return [entry.strip() for item in items for entry in item.plugin.references]


def _creator(text: str) -> Entity:
    """Return the entity of a creator such as ``Ada Lovelace <https://orcid.org/...>``, or of an unnamed one."""
    if not text:
        return _UNNAMED
    name, _, page = text.rstrip("> ").partition("<")
    affiliation = {"affiliation": {"@id": _UNNAMED["@id"]}}
    return {"@id": page.strip() or "#creator", "@type": "Person", "name": name.strip() or text, **affiliation}


def _license(text: str) -> Entity:
    if not text:
        return {"@id": "#license", "@type": "CreativeWork", "name": "no licence is stated"}
    page = text if re.match(r"https?://", text) else f"https://spdx.org/licenses/{text}"
    return {"@id": page, "@type": "CreativeWork", "name": text}


@file_problems
def crate_problems(folder: Path) -> list[str] | None:
    """Return the problems of a crate: of its metadata, of the digests of its files, and of its archives."""
    path = folder / METADATA
    if not path.is_file():
        return None
    try:
        entities = json.loads(path.read_text(encoding="utf-8"))["@graph"]
        files = {one["@id"]: one["sha256"] for one in entities if one["@type"] == "File"}
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        return [shown(f"{METADATA} is damaged: {error!r}")]
    problems = []
    for name, digest in files.items():
        file = folder / name
        if Path(name).name != name or not file.is_file():
            problems.append(shown(f"{name}: there is no such file in the folder"))
        elif hashlib.sha256(file.read_bytes()).hexdigest() != digest:
            problems.append(shown(f"{name}: it has changed since the crate was written"))
        elif file.suffix == ".h5":
            problems += [f"{name}: {problem}" for problem in check(file)]
    return problems
