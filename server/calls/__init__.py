"""What the client asks of the service, one noun a file."""
