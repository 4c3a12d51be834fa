"""What the routes ask for, one noun a file. Nothing here runs work; it is queued."""
