"""Numbers the columns of the table that says what each surface is."""

OBJECT, MOVES, COATED, ROUGH, MIRRORS = range(5)
COLUMNS = 5
