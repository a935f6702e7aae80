"""A whole spec as a strict, frozen pydantic model: checked as JSON data, with complaints in words, and hashed."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from pydantic import PrivateAttr, ValidationError

from mbdkit.errors import SpecError
from mbdkit.mechanism.law_element import Law
from mbdkit.spec.choices import registry_of
from mbdkit.spec.explain import explain
from mbdkit.spec.law_options import law_element
from mbdkit.spec.plain_data import canonical, plain
from mbdkit.spec.sections import Section
from mbdkit.spec.source_document import Document


class StrictSpec(Section):
    """Base of run and study specs.

    Raises
    ------
    SpecError
        If anything is wrong, with the key path.
    """

    _document: Document | None = PrivateAttr(default=None)

    def __init__(self, **data: Any):
        # A spec is JSON data whatever it was written in, so it is validated as such.
        try:
            text = json.dumps(plain(data), allow_nan=False)
            self.__pydantic_validator__.validate_json(text, self_instance=self, context={"find_law": self._find_law})
        except ValidationError as error:
            raise explain(error, type(self)) from None
        except RecursionError:
            raise SpecError("this spec is nested too deeply, or contains itself") from None

    @classmethod
    def _find_law(cls, name: str) -> type[Law]:
        return law_element(registry_of(cls).get("force-law", name))

    def placed(self, error: SpecError) -> SpecError:
        """Return an error about this spec with the file and line where its key was written, if it came from a file."""
        return error if self._document is None else self._document.place(error)

    def canonical_json(self) -> str:
        """Return the spec as canonical JSON: defaults filled in, keys of options sorted, numbers at their shortest.

        Names that the user gave (bodies, joints, forces) keep their order, which is that of the arrays in the archive.
        """
        return json.dumps(canonical(self), separators=(",", ":"), ensure_ascii=False, allow_nan=False)

    def sha256(self) -> str:
        """Return the SHA-256 of the canonical JSON in UTF-8, as hexadecimal digits."""
        return hashlib.sha256(self.canonical_json().encode()).hexdigest()
