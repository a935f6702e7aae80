"""Strength of the muscles of a person, relative to that of the person for whom the muscles of a model are given.

Size: the muscles of a leg have a volume of ``47 m h + 1285`` cm^3 for a mass m [kg] and a height h [m] (G. G.
Handsfield et al., J. Biomech. 47 (2014) 631-638, 24 young adults of both sexes). The force of a muscle is proportional
to its volume, divided by the length of its fibres, which is proportional to the height here.

Age: from the fifth decade of life, strength declines by 12 to 15 % a decade (B. F. Hurley, J. Gerontol. A 50 (1995)
41-44). With 13.5 %, it is reduced by 35 % at an age of 75 years; quadriceps of men in their seventies were 39 % weaker
than those of men in their twenties (A. Young, M. Stokes and M. Crowe, Clin. Physiol. 5 (1985) 145-154).

Replacement: more than two years after the replacement of a knee, its extension and flexion were 31 and 32 % weaker than
in healthy persons (M. Silva et al., J. Arthroplasty 18 (2003) 605-611). M. B. Schache, J. A. McClelland and K. E.
Webster (Knee 21 (2014) 12-20) found weaker quadriceps at all times, with effect sizes that differ by a factor of five.
"""

from __future__ import annotations

from mbdkit.base import elementary
from mbdkit_biomech.models._segments import BodySegments
from mbdkit_biomech.persons.person_sections import Subject

DECLINE, FROM = 0.135, 45.0  #: Decline of strength in a decade, and the age at which it begins [a].

#: Mean and standard deviation of the logarithm of the strength of adults of unknown age, whose ages are uniform from 20
#: to 80 years, relative to young adults.
UNKNOWN_AGE = -0.148, 0.168

REPLACED, REPLACED_DEVIATION = 0.685, 0.2  #: Strength after a replacement, and the standard deviation of its logarithm.


def strength_of(subject: Subject, model: BodySegments) -> float:
    """Return the factor of the forces of muscles of a person.

    Parameters
    ----------
    model
        The person for whom the muscles are given.
    """
    own, other = (47.0 * m * h + 1285.0 for m, h in ((subject.mass, subject.height), (model.body_mass, model.height)))
    decades = 0.0 if subject.age is None else max(subject.age - FROM, 0.0) / 10.0
    aged = elementary.exp(UNKNOWN_AGE[0]) if subject.age is None else elementary.pow(1.0 - DECLINE, decades)
    return own / other * model.height / subject.height * float(aged)
