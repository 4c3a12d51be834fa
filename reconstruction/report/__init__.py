"""Draws what a person looks at: the report, the curve, the orbit."""
