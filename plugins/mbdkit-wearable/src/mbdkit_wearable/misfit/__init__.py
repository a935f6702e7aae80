"""The packaged study `misfit`: what devices of the knee that do not fit add to its force, and what help is lost."""

from __future__ import annotations

from mbdkit import StudyPlugin


def _spec(quick: bool) -> dict[str, object]:
    """Return the spec of the study, whose motions are those of packaged examples."""
    from mbdkit_wearable.misfit.study import study

    return study(quick)


def _verdict(study: object) -> object:
    """Return the verdict on the study."""
    from mbdkit_wearable.misfit.verdict import verdict

    return verdict(study)  # type: ignore[arg-type]


STUDIES = (
    StudyPlugin(
        "misfit",
        "Force that a misplaced orthosis adds to the knee, shear of its cuffs and help lost, for three devices.",
        _spec,
        _verdict,
    ),
)
