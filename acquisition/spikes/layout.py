"""The layout of a spike plane in bytes, which a `.dat` does not state itself."""

from dataclasses import dataclass
from typing import Literal

from acquisition.errors import BadRecordingError

BitOrder = Literal["lsb", "msb"]
RowOrder = Literal["bottom", "top"]


@dataclass(frozen=True)
class PlaneLayout:
    """One bit a pixel, row-major, each plane padded with zero bits to whole bytes.

    `bit_order` states which bit of a byte is the first pixel, `row_order` which row is stored first. `trailing_columns`
    counts the bits behind the pixels of every stored row that are no light.
    """

    width: int
    height: int
    bit_order: BitOrder = "lsb"
    row_order: RowOrder = "bottom"
    trailing_columns: int = 0

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise BadRecordingError(f"found the size {self.width}x{self.height}", "at least 1x1")
        if self.trailing_columns < 0:
            raise BadRecordingError(f"found {self.trailing_columns} trailing columns", "0 or more")
        if self.bit_order not in ("lsb", "msb") or self.row_order not in ("bottom", "top"):
            found = f"found bit order {self.bit_order!r}, row order {self.row_order!r}"
            raise BadRecordingError(found, "lsb or msb, bottom or top")

    @property
    def stored_width(self) -> int:
        """Bits of one stored row."""
        return self.width + self.trailing_columns

    @property
    def plane_bytes(self) -> int:
        """Bytes of one plane."""
        return (self.stored_width * self.height + 7) // 8
