"""The engine at several budgets, and one choice changed at a time."""
