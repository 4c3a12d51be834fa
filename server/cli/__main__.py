"""`python -m server.cli`: how the worker starts a stage."""

from server.cli.main import main

main()
