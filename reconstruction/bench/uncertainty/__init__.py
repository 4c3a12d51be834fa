"""Expected errors beside true ones."""
