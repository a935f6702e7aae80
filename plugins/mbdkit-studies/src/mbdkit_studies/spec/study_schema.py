"""JSON schema of study specs."""

from __future__ import annotations

from mbdkit.registry.catalogue import Registry
from mbdkit.spec.schema import schema_on_bases
from mbdkit.spec.spec_kinds import spec_schema
from mbdkit_studies.spec.study_spec import StudySpec


@spec_schema
def study_schema(installed: Registry | None = None) -> dict[str, object]:
    """Return the JSON schema (draft 2020-12) of the study spec; its bases include the schema of the run spec.

    Parameters
    ----------
    installed
        Registry of the models, integrators and force laws to include; by default, all that are installed.
    """
    return schema_on_bases(StudySpec, installed, users=("Family",), quantities=None)
