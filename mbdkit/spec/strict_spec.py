"""Base class of specs: strict, frozen pydantic models with readable validation errors, canonical JSON and a hash."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from pydantic import PrivateAttr, ValidationError

from mbdkit.errors import SpecError
from mbdkit.mechanism.validation_errors import spec_error
from mbdkit.plain_data import canonical, plain
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

    _document: Document | None = PrivateAttr(default=None)

    def __init__(self, **data: Any):
        plugins = RegistryLookup(lambda: registry_of(type(self)))
        # Every source is validated as JSON: only then does pydantic's strict mode accept a list for a tuple.
        try:
            text = json.dumps(plain(data), allow_nan=False)
            self.__pydantic_validator__.validate_json(text, self_instance=self, context={"plugins": plugins})
        except ValidationError as error:
            raise spec_error(error, type(self), plugins=plugins) from None
        except RecursionError:
            raise SpecError("this spec is nested too deeply, or contains itself") from None

    def placed(self, error: SpecError) -> SpecError:
        """Return an error about this spec with the file and line of its key, if the spec was read from a file."""
        return error if self._document is None else self._document.place(error)

    def canonical_json(self) -> str:
        """Return the spec as canonical JSON: with defaults, sorted option keys and the shortest form of each number.

        Names given by the user (bodies, joints, forces) keep their order, which is the order of the archive's arrays.
        """
        return json.dumps(canonical(self), separators=(",", ":"), ensure_ascii=False, allow_nan=False)

    def sha256(self) -> str:
        """Return the SHA-256 digest of the canonical JSON in UTF-8, in hexadecimal."""
        return hashlib.sha256(self.canonical_json().encode()).hexdigest()
