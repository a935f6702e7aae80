"""Texts of specs for tests to change, and the place that a message about one of them names."""

from __future__ import annotations

SMALL = """\
mbdkit: 1
model:
  name: double-pendulum
  masses: [1.0, 1.0]
integrator: {name: gauss, stages: 2}
time:
  end: 1.0
  step: 0.01
"""


def mechanism(elements: str) -> str:
    """Return a spec of the free-form model; `elements` begins with the first body, which is line 7."""
    return f"""\
mbdkit: 1
integrator: {{name: rk4}}
time: {{end: 1, step: 0.1}}
model:
  name: mechanism
  bodies:
{elements}"""


def changed(text: str, old: str, new: str) -> str:
    """Return the text with `new` for `old`, which occurs in it once."""
    assert text.count(old) == 1
    return text.replace(old, new)


def place(file: object, line: int | None, key: str) -> str:
    """Return the start of a message: file, line and key."""
    where = str(file) if line is None else f"{file}:{line}"
    return f"{where}: {key}: " if key else f"{where}: "
