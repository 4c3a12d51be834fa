"""The stress catalogue: extreme input, and what each backend makes of it."""
