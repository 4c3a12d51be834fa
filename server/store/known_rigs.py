"""The rigs of a service, as its web process was told of them: every worker of any machine reads them here."""

from collections.abc import Sequence

from server.errors import NotFoundError
from server.store.records import Records
from server.store.tables import KnownRig, known_rigs


class KnownRigs(Records[KnownRig]):
    """The table of rigs."""

    table, row = known_rigs, KnownRig

    def replace(self, rigs: Sequence[KnownRig]) -> None:
        """Keep these rigs, and no others."""
        with self.writing() as connection:
            connection.execute(known_rigs.delete())
            for rig in rigs:
                connection.execute(known_rigs.insert(), vars(rig))

    def all(self) -> list[KnownRig]:
        """Return all rigs."""
        return self.select(order=known_rigs.c.id)

    def get(self, rig_id: str) -> KnownRig:
        """Return one rig; raises NotFoundError."""
        rigs = {rig.id: rig for rig in self.all()}
        if rig_id not in rigs:
            expected = f"one that the service was started with: {', '.join(rigs) or 'none yet'}"
            raise NotFoundError(f"found no rig {rig_id[:60]}", expected)
        return rigs[rig_id]
