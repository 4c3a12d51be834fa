"""The page an operator sees."""
