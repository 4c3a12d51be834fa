"""This revision and an older one in turns: ends of runs, single steps, movers."""
