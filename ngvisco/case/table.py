"""A table of a case file, what all sections are."""

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationInfo, model_validator


class Section(BaseModel):
    """A table of a case file: unknown keys and wrong types are refused.

    The context of a validation, if there is one, converts the table's data before (``ngvisco.case.units``).
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _converted(cls, data: Any, info: ValidationInfo) -> Any:
        return info.context(cls, data) if info.context and isinstance(data, dict) else data

    def completed(self, made: Any) -> Any:
        """What the keys that are no parameters make of the object that the others describe."""
        return made
