"""The cloud and how it moves."""
