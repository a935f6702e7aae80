"""Objects of plugins that are named by text and imported when they are first used."""

from __future__ import annotations

import pkgutil
import re
from typing import TYPE_CHECKING, Generic, cast

from mbdkit.base.distributions import entry_points, name_and_version
from mbdkit.base.errors import MbdkitError, PluginError, in_this_process, with_place
from mbdkit.base.interrupts import is_interrupt

if TYPE_CHECKING:
    from typing_extensions import TypeVar

    T = TypeVar("T", default=object)
else:
    from typing import TypeVar

    T = TypeVar("T")

_WHERE = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")


class Target(Generic[T]):
    """An object of a plugin, imported by the first call.

    Parameters
    ----------
    where
        Module and name of the object, as in ``Target("my_package.swing:build")``.
    """

    def __init__(self, where: str):
        if not isinstance(where, str) or not _WHERE.fullmatch(where):
            raise PluginError(f"the target {where!r} is not of the form 'package.module:name'")
        self.where = where
        self._objects: list[object] = []

    def __call__(self) -> T:
        """Return the object.

        Raises PluginError if the module cannot be imported, or the object is missing; the message names the
        distribution.
        """
        if not self._objects:
            try:
                with in_this_process():
                    self._objects.append(pkgutil.resolve_name(self.where))
            except BaseException as error:  # a module may raise any exception, including SystemExit
                if is_interrupt(error):
                    raise
                if type(error) is MbdkitError:  # the installation or the environment is wrong
                    raise
                sentence = with_place(error)
                raise PluginError(f"{self._distribution()} does not provide '{self.where}': {sentence}") from error
        return cast("T", self._objects[0])

    def _distribution(self) -> str:
        package = self.where.partition(".")[0].partition(":")[0]
        for entry_point in entry_points("mbdkit")[0]:
            if entry_point.value.partition(".")[0].partition(":")[0] == package and entry_point.dist is not None:
                return name_and_version(entry_point.dist)[0]
        return package

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Target) and self.where == other.where

    def __hash__(self) -> int:
        return hash(self.where)

    def __str__(self) -> str:
        return f"'{self.where}' of {self._distribution()}"

    def __repr__(self) -> str:
        return f"Target({self.where!r})"
