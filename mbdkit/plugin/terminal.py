"""What commands print and ask: options, tables, progress bars, and texts for people."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.base.command_words import for_shell as for_shell
    from mbdkit.base.html_view import HtmlView as HtmlView
    from mbdkit.base.interrupts import interrupts_noted as interrupts_noted
    from mbdkit.base.logs import logger_of as logger_of, warn_on_stderr as warn_on_stderr
    from mbdkit.base.progress_bars import (
        count_bar as count_bar, in_notebook as in_notebook, progress_bar as progress_bar, tally_bar as tally_bar,
    )
    from mbdkit.base.terminal import STOPPED_EARLY as STOPPED_EARLY, say as say, silence as silence
    from mbdkit.base.text import csv_cell as csv_cell, shortened as shortened, told_apart as told_apart
    from mbdkit.cli.common_options import (
        Archive as Archive, Archives as Archives, AsJson as AsJson, Debug as Debug, MotionSet as MotionSet,
        Overwrite as Overwrite, Printing as Printing, Quiet as Quiet, Set as Set, SpecName as SpecName,
        check_new as check_new, grouped as grouped, output_to as output_to, stem as stem,
    )
    from mbdkit.cli.outcome import tell as tell
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
