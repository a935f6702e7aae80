"""Processes that plugins fork."""

from __future__ import annotations

import os

import pytest

from mbdkit.base.errors import blaming


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("raises", [False, True])
def test_a_process_that_a_plugin_forks_ends_with_the_call_of_the_plugin(raises: bool) -> None:
    with blaming("the plugin"):
        child = os.fork()
        if child == 0 and raises:
            raise ValueError
    _, status = os.waitpid(child, 0)  # only one process arrives here
    assert os.waitstatus_to_exitcode(status) == 1
