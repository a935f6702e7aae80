"""Specs: strict models, sections, units, loading, schemas, named parameters, and the registry that knows the kinds."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.base.strict_model import STRICT as STRICT, description as description
    from mbdkit.base.units import described_units as described_units
    from mbdkit.mechanism.checks import check_name as check_name, check_tables as check_tables
    from mbdkit.mechanism.law_parameters import law_parameters as law_parameters
    from mbdkit.mechanism.parameters import (
        names_in as names_in, parameter_values as parameter_values, parameters_in_use as parameters_in_use,
    )
    from mbdkit.mechanism.validation_errors import spec_error as spec_error
    from mbdkit.registry.catalogue import Registered as Registered, Registry as Registry, Report as Report
    from mbdkit.registry.item import Plugin as Plugin
    from mbdkit.registry.item_options import item_of as item_of, named_options as named_options
    from mbdkit.registry.manager import registry as registry
    from mbdkit.registry.model_keys import model_keys as model_keys
    from mbdkit.spec.choices import Choice as Choice
    from mbdkit.spec.estimates import Estimated as Estimated, Estimates as Estimates
    from mbdkit.spec.formulation_choice import (
        BY_ACCELERATIONS as BY_ACCELERATIONS, choice_of as choice_of, name_of as name_of,
    )
    from mbdkit.spec.item_names import CriterionName as CriterionName
    from mbdkit.spec.loading import (
        RunSource as RunSource, Sections as Sections, example_names as example_names, load_spec as load_spec,
        read_source as read_source,
    )
    from mbdkit.spec.model_spec import ModelSpec as ModelSpec, StrictSpec as StrictSpec
    from mbdkit.spec.reading import (
        Document as Document, parse_key as parse_key, put as put, read_file as read_file, set_value as set_value,
        variable_path as variable_path,
    )
    from mbdkit.spec.schema import (
        DRAFT as DRAFT, allow_units as allow_units, described as described, model_schema as model_schema,
        run_schema as run_schema,
    )
    from mbdkit.spec.sections import Count as Count, Section as Section
    from mbdkit.spec.spec_kinds import kind_of as kind_of, refused as refused
    from mbdkit.spec.study_measures import (
        DefinedMeasure as DefinedMeasure, Measures as Measures, RunMeasures as RunMeasures, defined as defined,
    )
    from mbdkit.spec.table_files import read_columns as read_columns
    from mbdkit.spec.varied_specs import VariedSpecs as VariedSpecs
    from mbdkit.spec.yaml_reader import write_yaml as write_yaml
    from mbdkit.spec.reading import read_text as read_text
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
