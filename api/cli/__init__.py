"""The `skyfolio` command, one file per group of commands.

    main       registers all commands, and reports the user's mistakes with exit status 2
    lazy       commands that are imported when they are called
    planning, explain, robustness, check, keys, remote, serve, simulate, demo, bench, reproduce, sweep, warm_up
                       the commands
    files, terminal    files that commands read and write, plans as tables

It may import every room but `dashboard`. `skyfolio --help` takes a tenth of a second because `main` and `lazy` import
neither the planner nor the service: a test looks. So a command is registered in `main.COMMANDS` with the first line of
its docstring (a test compares), and imports what is slow inside its function. Exit status: 0, 1 when the answer is no,
2 for a mistake of the user, 3 for a plan that misses a minimum rate. With `--json`, nothing else is on standard output.
"""
