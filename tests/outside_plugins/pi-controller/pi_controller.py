"""PI.4.2 of Soderlind (2003): a controller of step sizes for methods whose steps stability limits."""

from pydantic import BaseModel, Field

from mbdkit.plugin import StepControl, StepFilter, hookimpl


class Options(BaseModel):
    safety: float = Field(0.9, gt=0, lt=1, description="Margin of the step size below the tolerance.")


def pi42(options: Options) -> StepFilter:
    return StepFilter(errors=(3 / 5, -1 / 5), safety=options.safety)


@hookimpl
def mbdkit_items():
    return [StepControl("pi42", "PI.4.2: steps that stability limits.", Options, pi42)]
