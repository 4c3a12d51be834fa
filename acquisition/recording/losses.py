"""Lists the planes of a stream that were lost."""

from collections.abc import Iterable

from acquisition.recording.manifest import Gap


def clip_gaps(gaps: Iterable[Gap], planes: int) -> tuple[Gap, ...]:
    """Return the gaps inside the first `planes` planes."""
    return tuple(
        Gap(g.first_plane, min(g.planes, planes - g.first_plane), g.layer) for g in gaps if g.first_plane < planes
    )


class Losses:
    """The gaps of a stream in order; what is lost in one layer without a break is one gap."""

    def __init__(self) -> None:
        self.gaps: list[Gap] = []

    def add(self, gap: Gap) -> None:
        """List planes that come behind all those listed so far."""
        before = self.gaps[-1] if self.gaps else None
        if before and before.layer == gap.layer and before.first_plane + before.planes == gap.first_plane:
            self.gaps[-1] = Gap(before.first_plane, before.planes + gap.planes, gap.layer)
        else:
            self.gaps.append(gap)

    def clip(self, planes: int) -> None:
        """Forget what lies beyond the first `planes` planes."""
        self.gaps = list(clip_gaps(self.gaps, planes))

    def refuse(self, kept: int, planes: int) -> None:
        """List planes [kept, planes) as lost in the layer `disk`, unless they were lost before."""
        lost_before = [gap for gap in self.gaps if gap.first_plane + gap.planes > kept]
        self.clip(kept)
        at = kept
        for gap in (*lost_before, Gap(planes, 1, "disk")):
            first = max(gap.first_plane, at)
            if first > at:
                self.gaps.append(Gap(at, first - at, "disk"))
            at = gap.first_plane + gap.planes
            if gap.first_plane < planes:
                self.gaps.append(Gap(first, at - first, gap.layer))
