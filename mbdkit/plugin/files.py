"""Files: reading and writing that damages nothing, locks, and plain data."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.base.files import replacing as replacing
    from mbdkit.base.plain_data import Path as Path, json_text as json_text
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
