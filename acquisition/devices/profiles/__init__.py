"""The kinds of camera the driver knows: one file a kind, each with one Profile."""
