"""Files: reading and writing that damages nothing, locks, and plain data."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.base import file_locks as file_locks
    from mbdkit.base.files import (
        check_folder as check_folder, check_not_input as check_not_input, check_output as check_output,
        check_regular as check_regular, check_suffix as check_suffix, rename_new as rename_new, replacing as replacing,
    )
    from mbdkit.base.files_read import (
        FileRead as FileRead, check_readable as check_readable, files_json as files_json, only_known as only_known,
        read_files as read_files,
    )
    from mbdkit.base.plain_data import (
        LONGEST_NAME as LONGEST_NAME, Path as Path, canonical as canonical, canonical_text as canonical_text,
        json_text as json_text,
    )
    from mbdkit.base.files import check_writable as check_writable
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
