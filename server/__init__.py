"""The service, its worker and the command line."""
