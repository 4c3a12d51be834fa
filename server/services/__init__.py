"""The services behind the routes, one noun a file. They queue work and never run it."""
