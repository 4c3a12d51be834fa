"""What travels over REST, one noun a file."""
