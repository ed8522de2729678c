"""A guidance whose 1 kHz law is wrapped in another one: delayed, counted or disturbed."""

from __future__ import annotations

from collections.abc import Callable

from railrepro.control import lateral


class _WithController:
    """A 1 kHz law together with the factory of the slower controllers whose torque it holds."""

    def __init__(self, law: lateral.LateralLaw, factory: lateral.Factory):
        self.memory, self.gains, self.torque, self._factory = law.memory, law.gains, law.torque, factory

    def __call__(self, vehicle, route, gear: int) -> lateral.SlowController:
        return self._factory(vehicle, route, gear)


def wrapped(guidance: lateral.Guidance, wrap: Callable[[lateral.LateralLaw], lateral.LateralLaw]) -> lateral.Guidance:
    """The guidance with `wrap` of its law in place of it."""
    law, factory = lateral.split(guidance)
    outer = wrap(law)
    return outer if factory is None else _WithController(outer, factory)
