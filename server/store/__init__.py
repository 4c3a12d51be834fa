"""The memory of the service: tables, folders and locks."""
