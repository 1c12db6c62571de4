"""`python -m api` is the `skyfolio` command."""

from api.cli import main

main()
