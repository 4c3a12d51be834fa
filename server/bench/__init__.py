"""What the service withstands and how fast it answers, measured on a whole service that runs on this machine."""
