"""The configuration's sections for the stages that compare, measure or show something, each on a page or in a table.

The schema as a whole is `pipeline.base.config`.
"""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, field_validator

from pipeline.base.sections import HomeContents, ModelKind
from pipeline.base.values import Positive, Section, distinct, listed


class Realism(Section):
    """How generated homes are compared with real ones."""

    generated_test: Positive
    models: Annotated[tuple[ModelKind, ...], BeforeValidator(listed), AfterValidator(distinct)]


TrainedOn = Literal["human", "homes", "both"]


class Housekeep(Section):
    """Which models are measured on people's votes, and what each is trained on."""

    models: Annotated[tuple[ModelKind, ...], BeforeValidator(listed), Field(min_length=1), AfterValidator(distinct)]
    trained_on: Annotated[tuple[TrainedOn, ...], BeforeValidator(listed), Field(min_length=1), AfterValidator(distinct)]


class Arm(Section):
    """A named change of the configuration: ``key=value`` as on the command line."""

    name: str = Field(min_length=1)
    overrides: Annotated[tuple[str, ...], BeforeValidator(listed), Field(min_length=1)]


class Ablation(Section):
    """How `pipeline.ablation` goes from the configured protocol to another one, and from `pouct_paper` to `pouct`."""

    switches: tuple[Arm, ...]
    steps: tuple[Arm, ...]
    added_alone: bool
    taken_alone: bool


class Factor(Section):
    """A key of the configuration and its values, one at a time."""

    name: str = Field(min_length=1)
    key: str = Field(min_length=1)
    values: Annotated[tuple[float, ...], Field(min_length=2), AfterValidator(distinct)]

    @field_validator("values", mode="before")
    @classmethod
    def _numbers(cls, values: Any) -> Any:
        if any(isinstance(value, bool) for value in values):
            raise ValueError("give numbers: they are the axis of a curve")
        return values


class Sensitivity(Section):
    """What `pipeline.sensitivity` changes, one factor at a time."""

    factors: Annotated[tuple[Factor, ...], Field(min_length=1)]


class Priors(Section):
    """Which contents and priors `pipeline.priors` compares."""

    contents: Annotated[
        tuple[HomeContents, ...], BeforeValidator(listed), Field(min_length=1), AfterValidator(distinct)
    ]
    trained_on: Annotated[tuple[HomeContents, ...], BeforeValidator(listed), AfterValidator(distinct)]
    others: Annotated[tuple[Literal["uniform", "truth"], ...], BeforeValidator(listed), AfterValidator(distinct)]


class Optimality(Section):
    """How far planners are from optimal: for which planners, on how many trials and worlds."""

    planners: Annotated[tuple[str, ...], BeforeValidator(listed), Field(min_length=1), AfterValidator(distinct)]
    trials_per_cell: Positive
    worlds: int = Field(ge=2)


class Replay(Section):
    """Which trial to show, and by which planners."""

    trial_id: str | None
    planners: Annotated[tuple[str, ...], BeforeValidator(listed), AfterValidator(distinct)]
