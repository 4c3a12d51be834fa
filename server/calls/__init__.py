"""The requests of the client, by noun."""
