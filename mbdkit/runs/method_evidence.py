"""Evidence of plugins: what ``mbdkit plugins verify --record`` has stored, and whether the installed code is that code.

The evidence of a plugin is a JSON file in its package; `mbdkit_testing.recorded_evidence` writes it. Files are read and
hashed once in a process.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel, ValidationError

from mbdkit.base.distributions import MBDKIT, code_of_distribution, own_version, required_versions
from mbdkit.base.plain_data import json_data
from mbdkit.base.text import listed
from mbdkit.engine.native import machine_code
from mbdkit.registry.catalogue import Origin, Registered

FILE, FORMAT, FORMAT_VERSION = "mbdkit-evidence.json", "mbdkit-evidence", 1
Word = Literal["verified", "changed since", "failed", "never", "checkout"]

_OWN = Path(__file__).parent.parent
#: Folders of mbdkit of which its methods consist, besides machine code; reading all of mbdkit takes ten times as long.
_OWN_CODE = ("methods", "integrators")
_CRLF, _LF = b"\r\n", b"\n"
MOST_NAMES = 3  #: Largest number of failed checks that are named.
#: Options that the checks vary themselves, as they do with limits such as ``max_step``.
_VARIED = ("rtol", "atol", "tolerance", "max_", "min_")


class PluginEvidence(NamedTuple):
    """What is known of the verification of a plugin.

    `word`: value of the attribute ``method_evidence`` of archives. `why`: reason, as a clause. `digest`: that of the
    installed code.
    """

    word: Word
    why: str
    digest: str

    def __str__(self) -> str:
        return f"{self.word}: {self.why}"


def code_of(origin: Origin) -> Path:
    """Return the folder of the package of a plugin, or the file of a module that is not in a package."""
    parts = origin.entry_point.partition("=")[2].partition(":")[0].strip().split(".")
    for count in range(1, len(parts) + 1):  # a namespace of several distributions is no package
        if file := getattr(sys.modules.get(".".join(parts[:count])), "__file__", None):
            return Path(file).parent if Path(file).stem == "__init__" else Path(file)
    return Path(parts[0])


def evidence_file(origin: Origin) -> Path:
    """Return the path of the evidence of a plugin; there may be none."""
    code = _OWN if origin.distribution == MBDKIT else code_of(origin)
    return code.with_name(f"{code.stem}-{FILE}") if code.suffix == ".py" else code / FILE


@cache
def code_digest(origin: Origin) -> str:
    """Return the digest of all files of the distribution of a plugin; of mbdkit, those that its methods consist of."""
    code = code_of(origin)
    if origin.distribution != MBDKIT:
        return digest_of(*{code, *code_of_distribution(origin.distribution)})
    built = machine_code.manifest().get("files", {})  # whose digests are known, because stored code depends on them
    lines = [f"{name} {machine_code.digest(name)}" for name in built]
    lines += _lines(str(_OWN), *(name for name in _files(str(_OWN), *_OWN_CODE) if name not in built))
    if code != _OWN:
        # machine code is that of the installed platforms
        lines += _lines(str(code), *(name for name in _files(str(code)) if not name.startswith("stored/")))
    return _joined(lines)


def digest_of(*code: Path) -> str:
    """Return the digest of all files of packages, and of modules that are not in a package.

    Names of files count from the package if there is only one, and from its folder if there are several.
    """
    lines = list[str]()
    for path in filter(Path.exists, code):
        prefix = f"{path.name}/" if len(code) > 1 and path.is_dir() else ""
        found = (
            _lines(str(path), *_files(str(path), suffix="")) if path.is_dir() else _lines(str(path.parent), path.name)
        )
        lines += [prefix + line for line in found]
    return _joined(lines)


def _joined(lines: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()


def _lines(folder: str, *names: str) -> Iterator[str]:
    """Yield name and digest of files below a folder."""
    for name in names:
        with open(f"{folder}/{name}", "rb", buffering=0) as file:  # pathlib takes twice as long
            yield f"{name} {hashlib.sha256(file.read().replace(_CRLF, _LF)).hexdigest()}"


def _files(folder: str, *below: str, suffix: str | tuple[str, ...] = (".py", ".json")) -> Iterator[str]:
    """Yield the paths of the files below a folder, without evidence and what Python and editors leave."""
    for inner in below or ("",):
        with os.scandir(f"{folder}/{inner}") as entries:
            for entry in entries:
                name = f"{inner}/{entry.name}".lstrip("/")
                if entry.name.startswith((".", "__pycache__")) or entry.name.endswith((".pyc", "~", FILE)):
                    continue
                if entry.is_dir():
                    yield from _files(folder, name, suffix=suffix)
                elif name.endswith(suffix):
                    yield name


def seal_of(record: Mapping[str, Any]) -> str:
    """Return the digest of a record without its own entry for it, which shows that figures have been edited."""
    text = json.dumps({key: value for key, value in record.items() if key != "sha256"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def read_records(path: Path) -> Sequence[Mapping[str, Any]]:
    """Return the records in a file of evidence; empty if there is no such file.

    Raises ValueError if it is damaged.
    """
    try:
        data = json_data(path.read_bytes())
    except FileNotFoundError:
        return ()
    if not isinstance(data, dict) or data.get("format") != FORMAT or data.get("format_version") != FORMAT_VERSION:
        raise ValueError(f"it is not in version {FORMAT_VERSION} of the format {FORMAT}")
    try:
        texts = ("kind", "name", "distribution", "version", "digest", "mbdkit", "date")
        kinds: dict[str, type] = dict.fromkeys(texts, str)
        kinds |= dict.fromkeys(("options", "requires", "checks", "claims"), dict)
        kinds |= {"failed": list, "skipped": list, "quick": bool}
        records = [{"requires": {}, **record} for record in data["records"]]
        if all(isinstance(record[key], kind) for record in records for key, kind in kinds.items()):
            return tuple(data["records"])
    except (LookupError, TypeError):
        pass
    raise ValueError("its records are incomplete")


def forget() -> None:
    """Read evidence again when it is next asked for, because it was written in this process."""
    read_records.cache_clear()
    _evidence_of.cache_clear()


def evidence_of(item: Registered, options: BaseModel | None = None) -> PluginEvidence:
    """Return what is known of the verification of a plugin with these options; by default, with any that were checked.

    `options`: those of a spec, with all defaults.
    """
    return _evidence_of(item, "" if options is None else options.model_dump_json())


@cache
def _evidence_of(item: Registered, chosen: str) -> PluginEvidence:
    origin, path = item.origin, evidence_file(item.origin)
    digest = code_digest(origin)
    is_own = origin.distribution == MBDKIT
    try:
        records = [one for one in read_records(path) if (one["kind"], one["name"]) == (item.kind, item.name)]
    except (OSError, ValueError) as error:
        return PluginEvidence("checkout" if is_own else "changed since", f"{path.name} cannot be read: {error}", digest)
    if not records:
        return PluginEvidence("checkout" if is_own else "never", "there is no evidence of it", digest)
    if chosen:
        values = json.loads(chosen)
        if not (records := [record for record in records if _covers(item, record["options"], values)]):
            is_changed = any(record["digest"] != digest for record in read_records(path))
            word: Word = "checkout" if is_own and is_changed else "never"
            return PluginEvidence(word, "it was verified with other options", digest)
    results = [_judged(item, record, digest) for record in records]
    ranks: tuple[Word, ...] = ("failed", "changed since", "checkout", "verified")
    return min(results, key=lambda result: ranks.index(result.word))


def _covers(item: Registered, checked: Mapping[str, Any], values: Mapping[str, Any]) -> bool:
    """Whether options are among those of a record, apart from tolerances and limits, which the checks vary."""
    try:
        known = with_defaults(item.plugin.options, checked)
    except ValidationError:  # the options have changed, and the digest with them
        return True
    return all(values.get(key) == value for key, value in known.items() if not key.startswith(_VARIED))


def with_defaults(options: type[BaseModel], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of all options, as JSON."""
    if not options.model_fields:  # BaseModel itself cannot be used
        return {}
    return options.model_validate_json(json.dumps(given)).model_dump(mode="json")


def _judged(item: Registered, record: Mapping[str, Any], digest: str) -> PluginEvidence:
    when, version = f"by mbdkit {record['mbdkit']} on {record['date']}", item.origin.version
    changed: Word = "checkout" if item.origin.distribution == MBDKIT else "changed since"
    if record.get("sha256") != seal_of(record):
        return PluginEvidence(changed, f"{FILE} was edited after it was written {when}", digest)
    if record["version"] != version:
        why = f"version {record['version']} was checked {when}, and {version} is installed"
        return PluginEvidence(changed, why, digest)
    now = own_version()
    if _minor(record["mbdkit"]) != _minor(now):
        return PluginEvidence(changed, f"it was checked {when}, and {now} is installed", digest)
    if record["digest"] != digest:
        edited, other = "the sources were edited after the checks", "its code is not that which was checked"
        return PluginEvidence(changed, f"{edited if changed == 'checkout' else other} {when}", digest)
    if not record["verified"] or not record["checks"]:
        names = record["failed"][:MOST_NAMES] or ["too few checks could be run"]
        more = f" and {len(record['failed']) - MOST_NAMES} more" if len(record["failed"]) > MOST_NAMES else ""
        return PluginEvidence("failed", f"{listed(names)}{more}, {when}", digest)
    quick = ", without the slow checks" if record["quick"] else ""
    requires = record.get("requires", {})
    now_there = required_versions(item.origin.distribution) if requires else {}
    changes = [f"{name} from {version} to {now_there.get(name, 'none')}" for name, version in requires.items()
               if now_there.get(name) != version]  # fmt: skip
    since = f"; since then, installed versions changed: {listed(changes)}" if changes else ""
    return PluginEvidence("verified", f"{when}{quick}{since}", digest)


def _minor(version: str) -> list[str]:
    return version.split(".")[:2]
