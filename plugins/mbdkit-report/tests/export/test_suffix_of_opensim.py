"""A table of OpenSim under its other suffix."""

from __future__ import annotations

import pytest

from mbdkit import MbdkitError
from mbdkit_report.export import suffix_of


def test_the_message_names_the_format_that_opensim_reads_as_well() -> None:
    with pytest.raises(MbdkitError) as raised:
        suffix_of("mot")
    told = str(raised.value)
    assert told.startswith("there is no format 'mot' (OpenSim reads sto wherever it reads mot); the formats are csv, ")
