"""`python -m skyfolio` is the `skyfolio` command."""

from skyfolio.api.cli.main import main

main()
