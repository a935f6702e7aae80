"""Loading of specs of predictions, whose base is a spec of runs."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeAlias

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import copied, parse_path, path_text, value_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.registry.catalogue import Registry
from mbdkit.spec.loading import loaded, read_source
from mbdkit.spec.reading import Document, put
from mbdkit.spec.schema import model_schema
from mbdkit.spec.spec_kinds import spec_loader, spec_schema
from mbdkit_predict.predict_spec import PredictSpec
from mbdkit_studies import base_document

#: A file, the name of a packaged example, a mapping, or a validated spec of a prediction.
PredictSource: TypeAlias = str | Path | Mapping[str, object] | PredictSpec

USED = ("parameters", "model")  #: Sections of the base that are used.
OF_BASE = ("base", "overrides")  #: Keys that are replaced when a spec is loaded.
#: Keys of a spec with a base.
KEYS = (*OF_BASE, *(key for key in PredictSpec.model_fields if key not in ("mbdkit", "model", "optimized")))
#: Keys that `guess` may replace.
OF_GUESS = ("parameters", *KEYS[KEYS.index("controls") : KEYS.index("tolerance")])


def load_predict_spec(source: object, assignments: Iterable[str] = (), **sections: object) -> PredictSpec:
    """Load and validate a spec of a prediction, build its mechanism, and return the spec.

    Arguments and errors are those of `load_spec`; the source may also be a `PredictSpec`.
    """
    if not isinstance(source, PredictSpec):
        document = read_source(source)
        with SpecError.place_by(document.place):
            document.data = _with_base(document.data | sections, document)
        source, sections = document, {}
    return loaded("predict", PredictSpec, source, assignments, sections)


spec_loader(load_predict_spec)


def _with_base(data: Mapping[str, object], document: Document) -> dict[str, object]:
    sections = dict(data)
    if isinstance(version := sections.get("mbdkit_predict"), int) and version > 1:
        return sections  # which the spec refuses for this reason alone
    if {"mbdkit", "integrator", "time"} <= sections.keys():
        wanted = "a spec of a prediction can name it as its `base`, and has `controls` and `minimize`"
        raise SpecError(f"this is a run spec: run it with `mbdkit run`; {wanted}", key="integrator")
    for key in sections:
        if key not in PredictSpec.model_fields and key not in OF_BASE:
            hint, later = did_you_mean(key, KEYS), "; a later version may know it"
            raise SpecError(f"unknown key{hint}; known here: {listed(KEYS)}{'' if hint else later}", key=key)
    if "base" not in sections:
        if "model" not in sections:
            raise SpecError("is missing: a file or an example, whose model is used, or a run spec", key="base")
        return sections
    base = sections.pop("base")
    if not isinstance(base, str | Mapping):
        wanted = "a file, the name of an example, or a run spec"
        raise SpecError(f"should be {wanted}, not {value_text(base)}", key="base")
    of_base = base_document(base, document.folder, "base", "prediction")
    base = of_base.data
    document.files.update(of_base.files)
    overrides = sections.pop("overrides", {})
    if not isinstance(overrides, Mapping):
        raise SpecError(f"should be a mapping of key paths and values, not {value_text(overrides)}", key="overrides")
    for key, value in overrides.items():
        path = parse_path(str(key))
        if path[0] not in USED:
            raise SpecError(f"'{key}' has no effect: only {listed(USED, 'and')} of the base are used", key="overrides")
        put(base, path, value)
    if "parameters" in sections:
        sections["optimized"] = sections.pop("parameters")
    return {
        "mbdkit": base.get("mbdkit", 1),
        **{key: base[key] for key in (*USED, "estimates") if key in base},
        **sections,
    }


def compared_spec(spec: PredictSpec) -> PredictSpec:
    """Return the spec of the motion that a spec is compared with."""
    data = copied(json.loads(spec.canonical_json()))
    for key, value in data.pop("compare").items():
        path = parse_path(key)
        if path[0] not in USED:
            raise SpecError(f"'{key}' has no effect, because only {listed(USED, 'and')} are compared", key="compare")
        put(data, path, value)
        if any(parse_path(name)[: len(path) - 1] == path[1:] for name in spec.controls):
            raise SpecError(f"'{key}' has no effect, because it is a control", key="compare")
        data.get("optimized", {}).pop(path_text(path[1:]), None)
    return load_predict_spec(Document(data | {"sensitivities": []}, folder=spec.folder))


def simpler_spec(spec: PredictSpec) -> PredictSpec | None:
    """Return the spec of the simpler problem whose optimum is the first guess; None without one."""
    if not isinstance(spec.guess, Mapping):
        return None
    data = json.loads(spec.canonical_json())
    given = {"optimized" if key == "parameters" else key: value for key, value in spec.guess.items()}
    for key in spec.guess:
        if key not in OF_GUESS:
            raise SpecError(f"should not be here; a guess replaces {listed(OF_GUESS, 'or')}", key=key)
    replaced = {"duration", "phases"} if given.keys() & {"duration", "phases"} else set()
    for key in ("guess", "compare", "starts", "sensitivities", *replaced):
        data.pop(key, None)
    return load_predict_spec(Document(data | given, folder=spec.folder))


@spec_schema
def predict_schema(installed: Registry | None = None) -> dict[str, object]:
    """Return the JSON schema (draft 2020-12) of the spec of a prediction, with a `base` or with its model, for the
    models and force laws of a registry; by default, for all that are installed.
    """
    schema = model_schema(PredictSpec, installed)
    fields = schema["properties"]
    words = "A run spec, whose model and named parameters are used: a file, the name of an example, or the spec itself."
    fields["base"] = {"anyOf": [{"type": "string"}, {"type": "object"}], "description": words}
    fields["overrides"] = {"type": "object", "description": "Values in the base by key path."}
    words = fields["parameters"]["description"]
    words += " With a `base`: numbers that are optimized, by their key path in the model."
    fields["parameters"] = {"anyOf": [fields["parameters"], fields["optimized"]], "description": words}
    schema["required"] = [name for name in schema["required"] if name not in ("mbdkit", "model")]
    return schema
