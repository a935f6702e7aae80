"""What commands print and ask: options, tables, progress bars, and texts for people."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.base.html_view import HtmlView as HtmlView
    from mbdkit.base.terminal import STOPPED_EARLY as STOPPED_EARLY, say as say, silence as silence
    from mbdkit.cli.common_options import (
        Overwrite as Overwrite, Printing as Printing, Set as Set, check_new as check_new, grouped as grouped,
        output_to as output_to, stem as stem,
    )
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
