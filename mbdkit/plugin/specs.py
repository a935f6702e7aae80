"""Specs: sections, documents and key paths, schemas, named parameters, and the registry that knows the kinds."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.mechanism.checks import check_name as check_name
    from mbdkit.mechanism.parameters import parameter_values as parameter_values, parameters_in_use as parameters_in_use
    from mbdkit.registry.catalogue import Registry as Registry
    from mbdkit.spec.choices import Choice as Choice
    from mbdkit.spec.loading import example_names as example_names, read_source as read_source, RunSource as RunSource
    from mbdkit.spec.model_spec import StrictSpec as StrictSpec
    from mbdkit.spec.reading import (
        Document as Document, parse_key as parse_key, put as put, variable_path as variable_path,
    )
    from mbdkit.spec.schema import schema_with_bases as schema_with_bases
    from mbdkit.spec.sections import Count as Count, Section as Section
    from mbdkit.spec.yaml_reader import write_yaml as write_yaml
    from mbdkit_biomech.inverse_dynamics.files.table_files import read_table as read_table
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
