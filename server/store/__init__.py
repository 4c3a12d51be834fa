"""What the service remembers: tables, folders and locks."""
