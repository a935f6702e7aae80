"""Functions of higher packages of mbdkit that lower packages call; ``mbdkit/__init__.py`` assigns them.

Imports point down: a package cannot import the packages that are built on it. A method of a lower package that needs a
higher one, such as `Mechanism.to_sympy`, calls one of these functions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

#: Returns the elementary functions of numbers by name; see `mbdkit.base.elementary`.
elementary_functions: Callable[[], Any]

#: Returns the values of an elementary function, given its name and arrays.
elementary_values: Callable[..., Any]

#: Returns the `PluginLookup` of the installed plugins, which finds the models of their options.
installed_plugins: Callable[[], Any]

#: Reads estimates of parameters from the result of an identification; see `mbdkit.archive.identified_parameters`.
identified_parameters: Callable[..., Any]

#: Returns the names of the attributes that mechanisms have without elements of plugins.
names_of_mechanisms: Callable[[], list[str]]

#: Returns the `SymbolicSystem` of a mechanism; with `numbers=True`, parameters are numbers instead of symbols.
symbolic_system: Callable[..., Any]

#: Returns the program of an expression of the state, and the quantities in it; see `mbdkit.events.state_program`.
state_program: Callable[..., Any]

#: Returns the values of an expression of the state at recorded states of a run; see `mbdkit.events.state_program`.
state_values: Callable[..., Any]

#: Raises `SpecError` if the gradients requested by a run spec do not exist with this method.
check_gradients: Callable[..., None]

#: Returns the gradients requested by a run spec, in the form stored in its archive.
gradients_json: Callable[..., str]

#: Returns the derivatives of measures of a run; see `SpecKind.differentiate`.
gradient_of_run: Callable[..., object]

#: Returns what is known of the errors of a simulated run; see `mbdkit.archive.accuracy_summary.RunErrors`.
run_errors: Callable[..., object]

#: Writes the root attribute ``answers`` of an archive; see `mbdkit.archive.headlines.write_answers`.
write_answers: Callable[..., None]

run_summary: Callable[..., str]  #: Returns the summary of a run as lines of text.

run_frame: Callable[[Any, str], Any]  #: Returns a group of a run as a pandas DataFrame.

#: Returns an open archive as an xarray DataTree, with some numbers of rows.
run_datatree: Callable[[Any, Any], Any]

html_of: Callable[[object], str] = repr  #: Returns an object as HTML, as notebooks show it.

prepared_run: Callable[[Any], Any]  #: Returns the `PreparedRun` of a run spec.

#: Returns the names of the built-in measures of studies, each with what it needs in addition to the run.
built_in_measures: Callable[[], Any]
