"""What every request passes before a route, and every answer on its way out."""
