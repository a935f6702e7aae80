"""A key of every model: bobs that hang from bodies on rods without mass."""

from mbdkit.plugin import ModelKey, Positive, StrictModel, Target, hookimpl
from mbdkit.plugin.seams import model_extension


class Bob(StrictModel):
    """A point mass on a rod, which hangs from the centre of a body."""

    body: str
    """Name of the body."""
    mass: Positive
    """Mass of the bob [kg]."""
    length: Positive = 0.2
    """Length of the rod [m]."""


def hang(values, mechanism):
    for name, bob in values.items():
        x, y = mechanism.to_global(bob.body, (0.0, 0.0))
        mechanism.body(name, mass=bob.mass, position=(x, y - bob.length))
        mechanism.distance(f"{name}-rod", bob.body, name, from_=(x, y), to=(x, y - bob.length), length=bob.length)


model_extension(hang)


@hookimpl
def mbdkit_items():
    bob, extend = Target("hung_bobs:Bob"), Target("hung_bobs:hang")
    return [ModelKey(name="hung_bobs", summary="Bobs that hang from bodies.", model=bob, extend=extend)]
