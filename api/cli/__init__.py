"""The `skyfolio` command, one file per group of commands.

    main       registers all commands
    mistakes   the one form in which the user's mistakes are reported, with exit status 2
    lazy       commands that are imported when they are called; `examples` has one of each, for its `--help`
    planning, explain, robustness, check, keys, remote, fleet, serve, simulate, demo, bench, reproduce, sweep, warm_up,
    completion         the commands
    files, terminal, progress, reasons
                       what commands read and write, plans as tables, how far a plan is, why a UAV is in its state

It may import every room but `dashboard`. `skyfolio --help` takes a tenth of a second because `main` and `lazy` import
neither the planner nor the service: a test looks. So a command is registered in `main.COMMANDS` with the first line of
its docstring (a test compares), has an example in `examples.EXAMPLES`, and imports what is slow inside its function.
Exit statuses are in `docs/cli.md`. With `--json`, nothing else is on standard output.
"""
