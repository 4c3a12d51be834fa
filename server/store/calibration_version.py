"""Which calibration of a rig is the current one."""

from __future__ import annotations

from dataclasses import dataclass

import sqlalchemy as sa

from server.store.tables import calibrations, current_calibrations


@dataclass(frozen=True)
class CalibrationVersion:
    """A version of a rig's calibration, where it came from and when."""

    version: int
    source: str
    created: str


def current_version(engine: sa.Engine, rig_id: str) -> CalibrationVersion | None:
    """The calibration that captures of the rig are made with; None where it is as it was drawn."""
    mine = sa.and_(
        calibrations.c.rig == current_calibrations.c.rig, calibrations.c.version == current_calibrations.c.version
    )
    query = (
        sa.select(calibrations.c.version, calibrations.c.source, calibrations.c.created)
        .join(current_calibrations, mine)
        .where(calibrations.c.rig == rig_id)
    )
    with engine.connect() as connection:
        row = connection.execute(query).mappings().first()
    return None if row is None else CalibrationVersion(**row)
