# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A setting of a node and of the command line: declared once, with its range and its help text."""

import difflib
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from .errors import ParameterError


@dataclass(frozen=True)
class Setting:
    """Name, default (which gives the type), meaning, unit and range of one setting."""

    name: str
    default: Any
    description: str
    unit: str = ''
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()
    dynamic: bool = False  #: whether a node's parameter can be changed after the start.
    optional: bool = False  #: whether None is allowed (left open); ROS has no None, so its default stands for it.
    length: int = 0  #: number of values of a list; 0: any number.
    distinct: bool = False  #: whether the values of a list have to be different and not empty.
    path: bool = False  #: whether a text is a path; a node expands ~ in it, because no shell does that after NAME:=.
    #: conversion of a text or a YAML value; by default, to the type of the default.
    read: Callable[[Any], Any] | None = None

    def of_ros(self, value: Any) -> Any:
        """Return the value of a ROS parameter: arrays as lists, and None if it is left open."""
        if isinstance(value, Iterable) and not isinstance(value, str):
            value = list(value)
        return None if self.optional and value == self.default else value

    def check(self, value: Any) -> None:
        """Check a value, and each entry of a list, against the range and the choices.

        Raises:
            ParameterError: the value is invalid.
        """
        if value is None and self.optional:
            return
        if self.length and len(value) != self.length:
            raise ParameterError(f'{self.name} has {len(value)} values; {self.length} are expected')
        if self.distinct and (len(set(value)) != len(value) or '' in value):
            raise ParameterError(f'{self.name} are {value}; {self.length} different names are expected')
        for entry in value if isinstance(value, (list, tuple)) else [value]:
            allowed = not self.choices or entry in self.choices
            if isinstance(entry, (int, float)):
                allowed = allowed and math.isfinite(entry) and self.minimum <= entry <= self.maximum
            if not allowed:
                raise self.refusal(entry)

    def parse(self, value: object) -> Any:
        """Return a text or a YAML value converted to the setting's type. May raise ParameterError."""
        if self.read is not None:
            return self.read(value)
        kind = type(self.default)
        try:
            return {'true': True, 'false': False}[str(value).lower()] if kind is bool else kind(str(value))
        except (KeyError, ValueError):
            raise self.refusal(value) from None

    def refusal(self, value: object) -> ParameterError:
        """Return the error with the given value and the expected one."""
        return ParameterError(f'{self.name} is {"empty" if value == "" else value}; {self.expected()} is expected')

    def expected(self) -> str:
        """Return the allowed values in words."""
        if self.choices:
            return f'one of {", ".join(self.choices)}'
        several = isinstance(self.default, (list, tuple))
        one, many = {
            bool: ('true or false', 'a list of true or false'),
            int: ('a whole number', 'a list of whole numbers'),
            float: ('a number', 'a list of numbers'),
            str: ('a text', 'a list of texts'),
        }[type(self.default[0] if several else self.default)]
        words = many if several else one
        low, high = math.isfinite(self.minimum), math.isfinite(self.maximum)
        if low and high:
            words += f' from {self.minimum:.10g} to {self.maximum:.10g}'
        elif low or high:
            words += f' of at least {self.minimum:.10g}' if low else f' of at most {self.maximum:.10g}'
        return words + (f' {self.unit}' if self.unit else '')

    def help(self) -> str:
        """Return the description with the unit."""
        return self.description + (f' [{self.unit}]' if self.unit else '')


def flag(name: str) -> str:
    """Return the name of a setting as an option of the command line."""
    return f'--{name.replace("_", "-")}'


def words(value: Any) -> list[str]:
    """Return the parts of a text with commas, or of a list."""
    parts = value if isinstance(value, (list, tuple)) else str(value).split(',')
    return [str(part).strip() for part in parts if str(part).strip()]


def interval(name: str, value: Any, example: str) -> tuple[float, float]:
    """Return the ends of an interval: a text LOW:HIGH, a pair of numbers, or one number for both ends.

    Raises:
        ParameterError: the value has another form.
    """
    ends = value.split(':') if isinstance(value, str) else value if isinstance(value, (list, tuple)) else [value]
    try:
        low, high = map(float, ends if len(ends) > 1 else [*ends, *ends])
    except (TypeError, ValueError):
        raise ParameterError(
            f'{name} {value!r} is not understood; LOW:HIGH or one number is expected, such as {example}'
        ) from None
    return low, high


def meant(name: str, known: Sequence[str]) -> str:
    """Return a question that suggests a similar known name."""
    near = difflib.get_close_matches(name, known, 1)
    return f'is {near[0]} meant' if near else 'which is meant'
