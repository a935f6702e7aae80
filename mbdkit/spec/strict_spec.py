"""Base class of specs: strict, frozen pydantic models with readable validation errors, canonical JSON and a hash."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import PrivateAttr, SerializerFunctionWrapHandler, model_serializer

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, canonical, canonical_text, plain, without_collection
from mbdkit.mechanism.parameters import Written, insert, parameter_values, with_expressions
from mbdkit.spec.choices import registry_of
from mbdkit.spec.registry_lookup import RegistryLookup
from mbdkit.spec.sections import Section
from mbdkit.spec.source_document import Document


class StrictSpec(Section):
    """Base class of run and study specs.

    Raises
    ------
    SpecError
        If the spec is not valid, with the key path.
    """

    EXPRESSIONS_IN: ClassVar[str] = ""
    """Section whose numbers may be expressions of `parameters`."""

    _document: Document | None = PrivateAttr(default=None)
    _numbers: dict[str, float] = PrivateAttr(default_factory=dict)
    _written: Written = PrivateAttr(default_factory=dict)
    _canonical: str = PrivateAttr(default="")

    @without_collection()
    def __init__(self, **data: Any):
        plugins = RegistryLookup(lambda: registry_of(type(self)))

        def validate(values: Any) -> None:
            # Every source is validated as JSON: only then does pydantic's strict mode accept a list for a tuple.
            text = json.dumps(values, allow_nan=False)
            self.__pydantic_validator__.validate_json(text, self_instance=self, context={"plugins": plugins})

        try:
            values = plain(data)
            numbers = parameter_values(values.get("parameters")) if self.EXPRESSIONS_IN else {}
            section = (self.EXPRESSIONS_IN,)
            _, written = with_expressions(validate, values, type(self), numbers, section=section, plugins=plugins)
        except RecursionError:
            raise SpecError("this spec is nested too deeply, or contains itself") from None
        self._numbers, self._written = numbers, written

    @property
    def numbers(self) -> Mapping[str, float]:
        """The values of the parameters by name."""
        return self._numbers

    @property
    def written(self) -> Mapping[Path, str]:
        """The expressions in place of numbers, by key path."""
        return self._written

    def sections(self) -> dict[str, Any]:
        """Return the sections by name, with expressions as written."""
        sections = {name: getattr(self, name) for name in type(self).model_fields}
        held = self.EXPRESSIONS_IN
        if self._written:
            sections[held] = insert({held: canonical(sections[held])}, self._written)[held]
        return sections

    @model_serializer(mode="wrap")
    def _as_written(self, serialize: SerializerFunctionWrapHandler) -> Any:
        data = serialize(self)
        return insert(plain(data), self._written) if self._written else data

    def placed(self, error: SpecError) -> SpecError:
        """Return an error about this spec with the file and line of its key, if the spec was read from a file."""
        return error if self._document is None else self._document.place(error)

    def canonical_json(self) -> str:
        """Return the spec as canonical JSON: with defaults, sorted option keys and the shortest form of each number.

        Expressions in place of numbers are kept as written.
        Names given by the user (bodies, joints, forces) keep their order, which is the order of the archive's arrays.
        """
        if not self._canonical:  # of a frozen model
            self._canonical = canonical_text(insert(canonical(self), self._written))
        return self._canonical

    def sha256(self) -> str:
        """Return the SHA-256 digest of the canonical JSON in UTF-8, in hexadecimal."""
        return hashlib.sha256(self.canonical_json().encode()).hexdigest()
