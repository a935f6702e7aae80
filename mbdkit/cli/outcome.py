"""The outcome of a run on the command line: its summary, its values for JSON, and the exit status."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

from mbdkit.base import terminal
from mbdkit.base.terminal import for_shell, say, show, show_json

if TYPE_CHECKING:
    from mbdkit.archive.accuracy import Accuracy
    from mbdkit.archive.run import Run
    from mbdkit.cli.common_options import Printing


def tell(result: Run, printing: Printing) -> None:
    """Print the outcome of a run, and exit with its exit status."""
    with result:
        if printing.as_json:
            show_json(_outcome(result))
        elif not printing.quiet:
            show(result.summary())
        verbose = not (printing.as_json or printing.quiet)
        if not verbose and result.status == "complete" and result.verdict in ("doubtful", "bad"):
            say(f"verdict {result.verdict}: {' '.join(result.verdict_reasons)}")
        exit_with(result, told=verbose)


def exit_with(result: Run, *, told: bool = False) -> None:
    """Exit with the exit status of an incomplete run; print the reason, unless the summary has already stated it
    (`told`).
    """
    if result.status == "complete":
        return
    if not told:
        say(f"{result.status}: {result.status_reason.removeprefix('interrupted: ')}")
    if result.status == "interrupted":
        from mbdkit.archive.part_file import checkpoint_path

        if result.path is not None and checkpoint_path(result.path).exists():
            say(f"to continue: {for_shell(['mbdkit', 'run', '--resume', str(result.path), '--overwrite'])}")
        raise typer.Exit(terminal.INTERRUPTED)
    failed_plugin = result.status_reason.startswith("plugin-error")
    raise typer.Exit(terminal.PLUGIN_FAILED if failed_plugin else terminal.STOPPED_EARLY)


def _measures(result: Run) -> dict[str, object]:
    return {name: measure["value"] for name, measure in result.measures.to_dict().items()}


def _errors(result: Run) -> dict[str, float]:
    return {name: error for name, error in result.measure_errors.items() if math.isfinite(error)}


def _outcome(result: Run) -> dict[str, object]:
    from mbdkit.archive.headlines import answers  # importing NumPy, like SciPy, would delay --help

    return {
        "path": None if result.path is None else str(result.path),
        "status": result.status,
        "status_reason": result.status_reason,
        "verdict": result.verdict,
        "verdict_reasons": result.verdict_reasons,
        "warnings": result.warnings,
        "run_id": result.run_id,
        "stats": dict(result.stats),
        "misalignment_max": result.misalignment_max,
        "answers": [answer.to_dict() for answer in answers(result)],
        "events": [asdict(event) for event in result.events],
        **({"measures": _measures(result)} if result.measures else {}),
        **({"gradients": dict(result.gradients)} if result.gradients else {}),
        **({"measure_errors": errors} if (errors := _errors(result)) else {}),
        **({} if result.accuracy is None else {"accuracy": _accuracy(result, result.accuracy)}),
    }


def _accuracy(result: Run, accuracy: Accuracy) -> dict[str, object]:
    """Return the estimated errors in numbers; None where they are unknown."""
    from mbdkit.archive.accuracy_summary import limit_sentence

    excluded = result.errors.excluded
    return {
        "known_until": _number(accuracy.known_until),
        "order_observed": _number(accuracy.order_observed),
        "position_error": _number(accuracy.position_error_max),
        "angle_error": _number(accuracy.angle_error_max),
        **({"limited": limit} if (limit := limit_sentence(result)) else {}),
        "method": accuracy.method,
        **({"not_included": excluded} if excluded else {}),
        **({} if math.isnan(accuracy.asked) else _asked(accuracy)),
    }


def _asked(accuracy: Accuracy) -> dict[str, object]:
    """Return the requested accuracy, the accuracy reached (None if unknown), and the choice of method and step."""
    return {
        "asked": accuracy.asked,
        "reached": _number(accuracy.reached),
        "chosen": accuracy.chosen,
        "why": accuracy.why,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
