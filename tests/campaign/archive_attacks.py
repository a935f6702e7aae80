"""Damaged and hostile archives against every command that reads one."""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
import tempfile
import zlib
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mbdkit.archive.archive_check import check
from mbdkit.archive.fingerprint import objects, seal
from mbdkit.archive.reader import load
from mbdkit_report.xarray_tree import OF_SCALES
from mbdkit_studies.store.blocks import Block

from .attack import Attack, Ending, in_child
from .specs import pendulum

READERS: dict[str, tuple[str, ...]] = {
    "info": ("archive", "info", "FILE"),
    "info --json": ("archive", "info", "FILE", "--json"),
    "check": ("archive", "check", "FILE"),
    "rerun": ("rerun", "FILE"),
    "report": ("report", "FILE", "-o", "page.html"),
    "report.md": ("report", "FILE", "-o", "page.md"),
    "plot": ("plot", "FILE", "-o", "plot.png"),
    "plot --kind reactions": ("plot", "FILE", "--kind", "reactions", "-o", "plot.svg"),
    "animate": ("animate", "FILE", "-o", "film.html"),
}
"""The commands that read an archive."""


def command_in_child(
    *arguments: str | Path, folder: Path, seconds: float = 10.0, prepare: Callable[[], None] = lambda: None
) -> Ending:
    """Run ``mbdkit ARGUMENTS`` in a fork of this process, which has imported everything already, after `prepare()`."""

    def call() -> tuple[int, str, str]:
        from mbdkit.cli import main

        os.chdir(folder)
        prepare()
        sys.argv = ["mbdkit", *map(str, arguments)]
        status = 0
        with (
            tempfile.TemporaryFile("w+", errors="replace") as out,
            tempfile.TemporaryFile("w+", errors="replace") as err,
        ):
            for file, stream in ((out, sys.stdout), (err, sys.stderr)):
                os.dup2(file.fileno(), stream.fileno())  # the command writes its results to the descriptor
            try:
                main()
            except SystemExit as end:
                status = int(end.code or 0)
            for file, stream in ((out, sys.stdout), (err, sys.stderr)):
                stream.flush()
                file.seek(0)
            return status, out.read(), err.read()

    ending = in_child(call, seconds=seconds)
    if ending.value is None:
        return ending
    status, output, errors = ending.value
    return Ending(status, ending.seconds, ending.memory, output, errors)


@cache
def small_archive() -> bytes:
    """Return the archive of a short run of two rods with events and estimated errors."""
    from mbdkit import run

    spec = pendulum(end=0.03) | {"model": {"name": "double-pendulum"}, "title": "two rods", "check": True}
    spec["events"] = {"down": {"when": "rod1.angle + 0.005"}}
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
        path = Path(folder) / "small.h5"
        with run(spec) as made:
            made.save(path)
        warm_up(path)
        return path.read_bytes()


def warm_up(path: Path) -> None:
    """Read an archive by every command in this process, so that its forks have imported and compiled everything."""
    from mbdkit.cli import app

    folder = path.parent
    for arguments in READERS.values():
        words = [str(path) if word == "FILE" else word for word in arguments]
        words = [str(folder / word) if "." in word and word != str(path) else word for word in words]
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
            app(words)


@cache
def small_block() -> bytes:
    """Return a block of five runs, one of which has failed, with all arrays."""
    from mbdkit import ensemble

    spec = pendulum(end=0.03) | {"model": {"name": "double-pendulum", "lengths": [1.0, 1.0]}}
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
        out = Path(folder) / "study"
        ensemble(spec, {"model.lengths.0": [1.0, 2.0, -1.0, 3.0, 4.0]}, store="all", out=out)
        return (out / "runs" / "block-000000.h5").read_bytes()


def contents(path: Path) -> dict[str, Any]:
    """Return all that an archive or a block holds, by path: values and attributes, without addresses of scales."""
    found: dict[str, Any] = {}
    with Block(path) if path.name.startswith("block") else load(path) as run:
        for item in (run.file, *objects(run.file)):
            found[item.name] = None
            if isinstance(item, h5py.Dataset):
                found[item.name] = (
                    item.dtype,
                    item.shape,
                    np.asarray(item[()]).tobytes() if item.dtype != object else list(item[()].ravel()),
                )
                for axis, dim in enumerate(item.dims):
                    found[f"{item.name}@{axis}"] = [scale.name for scale in dim.values()]
            for name in item.attrs:
                if name not in OF_SCALES:
                    value = item.attrs[name]
                    found[f"{item.name}@{name}"] = (
                        value.tolist() if isinstance(value, np.ndarray | np.generic) else value
                    )
    return {key: repr(value) for key, value in found.items()}


SMALL = {"run.h5": small_archive, "block-000000.h5": small_block}
"""Functions that return the contents of small files, by the name of the file."""


@cache
def small_contents(name: str) -> dict[str, Any]:
    """Return the contents of a small file by path."""
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
        path = Path(folder) / name
        path.write_bytes(SMALL[name]())
        return contents(path)


def flip(random: np.random.Generator, folder: Path, name: str = "run.h5") -> list[str]:
    """Flip one bit."""
    content = bytearray(SMALL[name]())
    bit = int(random.integers(8 * len(content)))
    content[bit // 8] ^= 1 << bit % 8
    return _damaged(bytes(content), f"bit {bit % 8} of byte {bit // 8}", folder / name)


def truncate(random: np.random.Generator, folder: Path, name: str = "run.h5") -> list[str]:
    """Leave out the end."""
    content = SMALL[name]()
    size = int(random.integers(len(content)))
    return _damaged(content[:size], f"the first {size} bytes", folder / name)


def _damaged(content: bytes, what: str, path: Path) -> list[str]:
    path.write_bytes(content)
    before = small_contents(path.name)

    def judge() -> tuple[list[str], bool]:
        found = check(path)
        try:
            return found, contents(path) == before
        except Exception:  # of HDF5, as a rule: what `contents` reads cannot be read
            return found, False

    ending = in_child(judge)
    problems = ending.problems(what=f"check of {what}")
    if problems:
        return problems
    found, harmless = ending.value
    if not found and not harmless:
        return [f"{what}: not found, and the contents differ"]
    if any("\n" in sentence for sentence in found):
        return [f"{what}: not one sentence a line: {found}"]
    return []


def _edit(change: Callable[[h5py.File, Path], None]) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        path.write_bytes(small_archive())
        with contextlib.ExitStack() as stack, h5py.File(path, "r+") as file:
            change(file, path.parent)
            # HDF5 cannot close a file in which something still refers to a scale that was deleted
            stack.enter_context(contextlib.suppress(RuntimeError))
            if file and _size(file) < 1 << 24:  # whoever falsifies an archive mends its hashes
                with contextlib.suppress(Exception):
                    seal(file)
                file.flush()

    return make


def _size(file: h5py.File) -> int:
    sizes = [0]
    file.visititems(lambda name, item: sizes.append(getattr(item, "nbytes", 0)) or None)
    return sum(sizes) if "a/x/x/x" not in file and "energy/heat" not in file else 1 << 60


def _replace(path: str, **options: Any) -> Callable[[h5py.File, Path], None]:
    def change(file: h5py.File, folder: Path) -> None:
        given = {key: value(file, folder) if callable(value) else value for key, value in options.items()}
        del file[path]
        file.create_dataset(path, **given)

    return change


def _virtual(file: h5py.File, folder: Path) -> None:
    shape = file["energy/kinetic"].shape
    layout = h5py.VirtualLayout(shape, "f8")
    layout[:] = h5py.VirtualSource(str(_secret(folder)), "secret", shape)
    del file["energy/kinetic"]
    file.create_virtual_dataset("energy/kinetic", layout)


def _secret(folder: Path) -> Path:
    path = folder / "secret.h5"
    if not path.exists():
        with h5py.File(path, "w") as other:
            other["secret"] = np.full(100, 4711.4711)
            other["group/text"] = np.array(["password"], object)
    return path


def _external_storage(file: h5py.File, folder: Path) -> None:
    shape = file["energy/kinetic"].shape
    (folder / "secret.bin").write_bytes(np.full(shape, 4711.4711).tobytes())
    del file["energy/kinetic"]
    file.create_dataset("energy/kinetic", shape, "<f8", external=[(str(folder / "secret.bin"), 0, h5py.h5f.UNLIMITED)])


def _doubled_groups(file: h5py.File, folder: Path) -> None:
    group = file.create_group("a")
    for _ in range(40):
        below = group.create_group("x")
        group["y"] = below
        group = below


def _group_for_array(file: h5py.File, folder: Path) -> None:
    del file["energy/kinetic"]
    file.create_group("energy/kinetic")


def _array_for_group(file: h5py.File, folder: Path) -> None:
    del file["stats"]
    file["stats"] = 1.0


def _bomb(file: h5py.File, folder: Path) -> None:
    file.create_dataset("energy/heat", (1 << 27,), "<f8", chunks=(1 << 20,), compression="gzip", fillvalue=0.0)
    for start in range(0, 1 << 27, 1 << 24):
        file["energy/heat"][start : start + (1 << 24)] = 0.0


def _chunk_bomb(file: h5py.File, folder: Path) -> None:
    # a chunk that is declared small and unpacks to 640 MiB
    dataset = file.create_dataset("energy/heat", (1 << 10,), "<f8", chunks=(1 << 10,), compression="gzip")
    packer = zlib.compressobj(1)
    packed = b"".join(packer.compress(bytes(1 << 24)) for _ in range(40)) + packer.flush()
    dataset.id.write_direct_chunk((0,), packed)


def _shared_text(file: h5py.File, folder: Path) -> None:
    # a million strings that share one of a megabyte: their descriptors are equal
    count = 1 << 16
    file.create_dataset("notes/text", (count,), h5py.string_dtype())
    file["notes/text"][0] = "x" * (1 << 20)
    file.flush()
    dataset = file["notes/text"].id
    if dataset.get_offset() is None:
        return
    start = dataset.get_offset()
    name = file.filename
    file.close()
    with open(name, "r+b") as stream:
        stream.seek(start)
        one = stream.read(16)
        stream.seek(start)
        stream.write(one * count)


def _set(path: str, name: str, value: Any) -> Callable[[h5py.File, Path], None]:
    return lambda file, folder: file[path].attrs.__setitem__(name, value)


def _spec(**sections: Any) -> Callable[[h5py.File, Path], None]:
    def change(file: h5py.File, folder: Path) -> None:
        from mbdkit.archive.fingerprint import spec_sha256

        text = json.dumps(json.loads(file.attrs["spec"]) | sections)
        file.attrs["spec"] = text
        file.attrs["spec_sha256"] = spec_sha256(text)

    return change


def _link(path: str, link: Callable[[Path], Any]) -> Callable[[h5py.File, Path], None]:
    def change(file: h5py.File, folder: Path) -> None:
        if path in file:
            del file[path]
        file[path] = link(folder)

    return change


def _values(path: str, value: Any) -> Callable[[h5py.File, Path], None]:
    return lambda file, folder: file[path].__setitem__(..., value)


def _delete(path: str) -> Callable[[h5py.File, Path], None]:
    return lambda file, folder: file.__delitem__(path)


def _of(path: str) -> Callable[[h5py.File, Path], Any]:
    return lambda file, folder: file[path].shape


_HUGE = 1 << 40  # 8 TiB of float64

FORGED = "all hashes match, says the attacker"
_TWO_LINES = f"x\n{FORGED}"

HOSTILE: dict[str, Callable[[h5py.File, Path], None]] = {
    "external link to a file": _link(
        "energy/kinetic", lambda folder: h5py.ExternalLink(str(_secret(folder)), "/secret")
    ),
    "external link to a group": _link("provenance", lambda folder: h5py.ExternalLink(str(_secret(folder)), "/group")),
    "external link to a device": _link("energy/kinetic", lambda folder: h5py.ExternalLink("/dev/zero", "/secret")),
    "soft link": _link("energy/kinetic", lambda folder: h5py.SoftLink("/energy/potential")),
    "soft link to itself": _link("energy/kinetic", lambda folder: h5py.SoftLink("/energy/kinetic")),
    "soft link in the root": _link("zzz", lambda folder: h5py.SoftLink("/nowhere")),
    "external storage": _external_storage,
    "virtual dataset": _virtual,
    "cycle": lambda file, folder: file["energy"].__setitem__("again", file["/"]),
    "cycle of groups": lambda file, folder: file.create_group("a/b").__setitem__("c", file["a"]),
    "hard link to an array": lambda file, folder: file.__setitem__("energy/heat", file["energy/kinetic"]),
    "hard link to a group": lambda file, folder: file.__setitem__("energy2", file["energy"]),
    "forty doubled groups": _doubled_groups,
    "deep groups": lambda file, folder: file.create_group("/".join(["a"] * 500)) and None,
    "many groups": lambda file, folder: [file.create_group(f"many/{n}") for n in range(3000)] and None,
    "object references": _replace(
        "energy/kinetic", data=lambda file, folder: np.array([file["energy"].ref] * 4, h5py.ref_dtype)
    ),
    "region references": _replace(
        "energy/kinetic",
        data=lambda file, folder: np.array([file["energy/total"].regionref[:2]] * 4, h5py.regionref_dtype),
    ),
    "reference as attribute": lambda file, folder: file["provenance"].attrs.__setitem__("mbdkit", file["energy"].ref),
    "eight TiB, never written": _replace("energy/kinetic", shape=(_HUGE,), dtype="<f8"),
    "eight TiB in chunks": _replace("energy/kinetic", shape=(_HUGE,), dtype="<f8", chunks=(1 << 14,)),
    "eight TiB of time": _replace("trajectory/time", shape=(_HUGE,), dtype="<f8", chunks=(1 << 14,)),
    "eight TiB of names": _replace("trajectory/body", shape=(_HUGE,), dtype=h5py.string_dtype(), chunks=(1 << 14,)),
    "eight TiB of an unknown array": lambda file, folder: file.create_dataset("energy/heat", (_HUGE,), "<f8") and None,
    "gzip bomb": _bomb,
    "gzip bomb in one chunk": _chunk_bomb,
    "strings that share their characters": _shared_text,
    "empty dataset": _replace("energy/kinetic", data=h5py.Empty("f8")),
    "empty attribute": _set("provenance", "mbdkit", h5py.Empty("f8")),
    "compound": _replace("energy/kinetic", data=np.zeros(4, [("a", "f8"), ("b", "i8")])),
    "long fixed string": _replace("trajectory/body", data=np.array([b"x" * (1 << 20)] * 2)),
    "long name": _values("trajectory/body", "x" * (1 << 20)),
    "long title": _spec(title="x " * (1 << 19)),
    "long title of a thousand words": _spec(title="word " * 1000),
    "no rows": _replace("trajectory/time", shape=(0,), dtype="<f8"),
    "other length": _replace("trajectory/position", data=np.zeros((2, 2, 3))),
    "other rank": _replace("trajectory/position", data=np.zeros(4)),
    "32 axes": _replace("energy/kinetic", data=np.zeros((1,) * 32)),
    "group for an array": _group_for_array,
    "array for a group": _array_for_group,
    "no bodies": _delete("trajectory/body"),
    "no joints": _delete("joints/joint"),
    "no positions": _delete("trajectory/position"),
    "no joint group": _delete("joints"),
    "no provenance": _delete("provenance"),
    "values not a number": _values("trajectory/position", np.nan),
    "values infinite": _values("joints/reaction_force", np.inf),
    "values huge": _values("trajectory/position", 1e308),
    "time not a number": _values("trajectory/time", np.nan),
    "time backwards": _values("trajectory/time", 0.0),
    "names equal": _values("trajectory/body", "rod1"),
    "names strange": _values("joints/first_body", "nobody"),
    "name with a bad byte": lambda file, folder: file["trajectory/body"].__setitem__(0, b"\xff\xfe"),
    "counter is a string": _set("stats", "steps", "many"),
    "counter is an array": _set("stats", "steps", np.zeros(10)),
    "time is a string": _set("stats", "wall_s", "long"),
    "provenance is an array": _set("provenance", "mbdkit", np.zeros((3, 3))),
    "status unknown": _set("/", "status", "splendid"),
    "status running": _set("/", "status", "running"),
    "status failed": _set("/", "status", "failed"),
    "version is a number": _set("/", "format_version", 1.0),
    "verdict is an array": _set("/", "verdict", np.arange(5)),
    "reasons are numbers": _set("/", "verdict_reasons", np.arange(5)),
    "misalignments missing": lambda file, folder: file["joints"].attrs.__delitem__("misalignment_max"),
    "misalignments too few": _set("joints", "misalignment_max", np.zeros(1)),
    "misalignments are text": _set("joints", "misalignment_max", "large"),
    "accuracy without attributes": lambda file, folder: file["accuracy"].attrs.clear(),
    "accuracy is text": _set("accuracy", "known_until", "the end"),
    "accuracy until later": _set("accuracy", "known_until", 1e9),
    "units are an array": _set("energy/kinetic", "units", np.arange(3)),
    "spec is no JSON": _set("/", "spec", "{"),
    "spec is deep": _set("/", "spec", "[" * 100_000 + "]" * 100_000),
    "spec is a list": _set("/", "spec", "[]"),
    "spec has a huge number": _set("/", "spec", '{"mbdkit": ' + "9" * 10_000 + "}"),
    "spec model is a list": _spec(model=[1]),
    "spec model has no name": _spec(model={}),
    "spec model of a stranger": _spec(model={"name": "$(reboot)"}),
    "spec integrator is a string": _spec(integrator="rk4"),
    "spec time is null": _spec(time=None),
    "spec step is a string": _spec(time={"end": 1.0, "step": "x"}),
    "spec events are a list": _spec(events=["down"]),
    "spec title is a list": _spec(title=["x", ["y"]]),
    "spec title steers a terminal": _spec(title="\x1b[2J\x1b]0;owned\x07\r\nverdict       good"),
    "spec title is HTML": _spec(title="<script>alert(1)</script>|=cmd()"),
    "spec output is a string": _spec(output="all"),
    "spec stabilization is a number": _spec(stabilization=7),
    "spec of another mechanism": _spec(model={"name": "n-pendulum", "n": 5}),
    "scale of another group": lambda file, folder: _other_scale(file),
    "array named in two lines": lambda file, folder: file["energy"].__setitem__(_TWO_LINES, [1.0]),
    "link named in two lines": _link(_TWO_LINES, lambda folder: h5py.SoftLink("/energy")),
    "group named in two lines": lambda file, folder: file.create_group(_TWO_LINES) and None,
    "body named in two lines": lambda file, folder: file["trajectory/body"].__setitem__(0, _TWO_LINES),
    "event named in two lines": lambda file, folder: file["events/name"].__setitem__(..., _TWO_LINES),
    "provenance in two lines": _set("provenance", "mbdkit", _TWO_LINES),
    "provenance named in two lines": _set("provenance", _TWO_LINES, "x"),
    "reason in two lines": _set("/", "verdict_reasons", [_TWO_LINES]),
    "status reason in two lines": _set("/", "status_reason", f"event: {_TWO_LINES}"),
    "version in two lines": _set("/", "format_version", _TWO_LINES),
    "spec key in two lines": _spec(**{_TWO_LINES: 1}),
    "spec value in two lines": _spec(formulation=_TWO_LINES),
    "spec title in two lines": _spec(title=_TWO_LINES),
    "spec step of 400 digits": _spec(time={"end": 1.0, "step": 10**400}),
    "plugin of a stranger": lambda file, folder: file["provenance"].attrs.update(
        {"model": "evil:x", "model_distribution": "evil'; rm -rf ~ #", "model_version": "1"}
    ),
}
"""Changes of a sound archive, by name."""


def _other_scale(file: h5py.File) -> None:
    file["energy/total"].dims[0].detach_scale(file["energy/time"])
    file["energy/total"].dims[0].attach_scale(file["joints/time"])


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _sparse(path: Path) -> None:
    path.write_bytes(small_archive())
    with h5py.File(path, "r+") as file:
        plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        plan.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        space = h5py.h5s.create_simple((1 << 37,))
        h5py.h5d.create(file["energy"].id, b"heat", h5py.h5t.IEEE_F64LE, space, plan)


FILES: dict[str, Callable[[Path], None]] = {
    **{name: _edit(change) for name, change in HOSTILE.items()},
    "pipe": _pipe,
    "link to a device": lambda path: path.symlink_to("/dev/zero"),
    "link to itself": lambda path: path.symlink_to(path),
    "folder": lambda path: path.mkdir(),
    "a terabyte of holes": _sparse,
    "empty file": lambda path: path.touch(),
    "text": lambda path: path.write_text("mbdkit: 1\n") and None,
}
"""Hostile files, by name."""


def hostile(random: np.random.Generator, folder: Path) -> list[str]:
    """Read a hostile file by three commands."""
    names, commands = list(FILES), random.permutation(list(READERS))[:3]
    return read_hostile(names[int(random.integers(len(names)))], [str(command) for command in commands], folder)


def read_hostile(name: str, commands: Sequence[str], folder: Path) -> list[str]:
    """Return what did not hold when a hostile file was read by some commands."""
    small_archive()
    path = folder / "hostile.h5"
    made = in_child(FILES[name], path, seconds=60)
    if made.exit_status != 0:
        return [f"'{name}' could not be made: {made.errors.strip().splitlines()[-1:]}"]
    found = []
    for command in commands:
        words = [str(path) if word == "FILE" else word for word in READERS[command]]
        ending = command_in_child(*words, folder=folder)
        allowed = (0, 1, 2, 3) if command == "rerun" else (0, 2, 3)
        found += ending.problems(allowed=allowed, what=f"{command} of '{name}'")
        for place, text in (("stdout", ending.output), ("stderr", ending.errors)):
            if any(char in text for char in "\x1b\x07\x9b\r"):
                found.append(f"{command} of '{name}' printed a control character to {place}")
            if any(line.strip().startswith(FORGED) for line in text.splitlines()):
                found.append(f"{command} of '{name}' printed a line of the archive to {place}")
        for result in (folder / "page.html", folder / "page.md"):
            text = result.read_text() if result.exists() else ""
            if "4711.47" in text + ending.output or "password" in text + ending.output:
                found.append(f"{command} of '{name}' showed another file's contents")
            if "<script>alert" in text:
                found.append(f"{command} of '{name}' wrote a script into {result.name}")
        for result in folder.iterdir():
            if result.is_file() and result.name not in ("hostile.h5", "secret.h5", "secret.bin"):
                result.unlink()
    return found


ATTACKS = (
    Attack(
        "flips", "one flipped bit of an archive: `archive check` finds it unless all contents are the same", 500, flip
    ),
    Attack("truncations", "the first bytes of an archive: `archive check` refuses them", 300, truncate),
    Attack(
        "block-flips",
        "one flipped bit of a block: `archive check` finds it",
        500,
        partial(flip, name="block-000000.h5"),
    ),
    Attack(
        "block-truncations",
        "the first bytes of a block: `archive check` refuses them",
        300,
        partial(truncate, name="block-000000.h5"),
    ),
    Attack("archives", "hostile archives: every reading command refuses or survives them", 1000, hostile),
)
