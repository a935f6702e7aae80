"""Functions of higher packages of mbdkit that lower packages call; they are imported when they are called.

Imports point down: a package cannot import the packages that are built on it. A method of a lower package that needs a
higher one, such as `Mechanism.to_sympy`, calls one of these functions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mbdkit.base.lazy_names import import_part


def _function(module: str, name: str, wanted: str = "") -> Callable[..., Any]:
    """Return a function that, when called, imports a function of another module and calls it.

    `wanted` is what users call it; see `import_part`.
    """

    def imported(*arguments: object, **named: object) -> Any:
        """Import the function, and return what it returns."""
        return getattr(import_part(module, wanted or name), name)(*arguments, **named)

    return imported


#: Returns the elementary functions of numbers by name; see `mbdkit.base.elementary`.
elementary_functions = _function("mbdkit.engine.kernels.elementary_calls", "functions_of_numbers")

#: Returns the values of an elementary function, given its name and arrays.
elementary_values = _function("mbdkit.engine.kernels.elementary_calls", "values_of")

#: Returns the `PluginLookup` of the installed plugins, which finds the models of their options.
installed_plugins = _function("mbdkit.spec.choices", "RegistryLookup")

#: Reads estimates of parameters from the result of an identification; see `mbdkit.archive.identified_parameters`.
identified_parameters = _function("mbdkit.archive.identified_parameters", "read_identified")

#: Returns the names of the attributes that mechanisms have without elements of plugins.
names_of_mechanisms = _function("mbdkit.mechanism.mechanism", "own_names")

#: Returns the `SymbolicSystem` of a mechanism; with `numbers=True`, parameters are numbers instead of symbols.
symbolic_system = _function("mbdkit_statics.symbolic_equations", "build_system", "Mechanism.to_sympy")

#: Returns the program of an expression of the state, and the quantities in it; see `mbdkit.events.state_program`.
state_program = _function("mbdkit.events.state_program", "state_program")

#: Returns the values of an expression of the state at recorded states of a run; see `mbdkit.events.state_program`.
state_values = _function("mbdkit.events.state_program", "state_values")

#: Raises `SpecError` if the gradients requested by a run spec do not exist with this method.
check_gradients = _function("mbdkit_gradients.measure_gradients", "check_gradients", "the key gradients")

#: Returns the gradients requested by a run spec, in the form stored in its archive.
gradients_json = _function("mbdkit_gradients.measure_gradients", "gradients_json", "the key gradients")

#: Returns the derivatives of measures of a run; see `SpecKind.differentiate`.
gradient_of_run = _function("mbdkit_gradients.measure_gradients", "gradient_of_run_spec", "a gradient")

#: Returns what is known of the errors of a simulated run; see `mbdkit.archive.accuracy_summary.RunErrors`.
run_errors = _function("mbdkit.archive.accuracy_summary", "RunErrors")

#: Writes the root attribute ``answers`` of an archive; see `mbdkit.archive.headlines.write_answers`.
write_answers = _function("mbdkit.archive.headlines", "write_answers")

#: Returns the summary of a run as lines of text.
run_summary: Callable[..., str] = _function("mbdkit.archive.run_summary", "summary")

#: Returns a group of a run as a pandas DataFrame.
run_frame = _function("mbdkit_report.group_table", "to_frame", "Run.to_frame")

#: Returns an open archive as an xarray DataTree, with some numbers of rows.
run_datatree = _function("mbdkit_report.xarray_tree", "to_datatree", "Run.to_xarray")

#: Returns an object as HTML, as notebooks show it.
html_of: Callable[[object], str] = _function("mbdkit_report.notebook.result_views", "html_of")

#: Returns the `PreparedRun` of a run spec.
prepared_run = _function("mbdkit_studies.lanes.prepared_run", "PreparedRun", "Simulation.reset with numbers")

#: Returns the names of the built-in measures of studies, each with what it needs in addition to the run.
built_in_measures = _function("mbdkit_studies.spec.measures", "built_in_measures")
