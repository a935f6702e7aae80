"""The draw of commits for `where_to_change.yaml`: ``python -m tests.draw_where_to_change`` prints them in order.

They are those of 200 commits that precede the big moves of files and change 1 to 6 files of source code, in an order
that depends on a seed. Those that only change texts, types or imports, or only move code, are skipped in reading.
"""

from __future__ import annotations

import random
import subprocess

from tests.first_party import ROOT

LAST = "Criteria have templates too, a kind of specs takes 60 lines"
"""Beginning of the subject of the last one of the 200 commits."""

MOVES = "Move eleven rooms to parts below plugins/"
"""Beginning of the subject of the last commit that is left out, in the order of the log."""

SEED, MOST_FILES = 200, 6


def _git(*arguments: str) -> list[str]:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def _source_files(commit: str) -> list[str]:
    names = [line.split("\t")[-1] for line in _git("show", "--numstat", "-M", "--format=", commit) if line]
    names = [name for name in names if name.endswith(".py") and "conftest" not in name]
    return [name for name in names if not name.startswith("tests/") and "/tests/" not in name]


def drawn() -> list[tuple[str, list[str]]]:
    """Return the subjects of the commits in the order of the draw, with the files of source code that each changes."""
    (last,) = _git("log", "--format=%h", "-1", "--fixed-strings", f"--grep={LAST}")
    commits = [line.split("\t", 1) for line in _git("log", "-200", "--no-merges", "--format=%h\t%s", last)]
    begin = next(index for index, (_, subject) in enumerate(commits) if subject.startswith(MOVES))
    found = [(subject, _source_files(commit)) for commit, subject in commits[begin + 1 :]]
    found = [(subject, files) for subject, files in found if 1 <= len(files) <= MOST_FILES]
    random.Random(SEED).shuffle(found)
    return found


if __name__ == "__main__":
    for subject, files in drawn():
        print(subject, *files, sep="\n    ")
