"""Webhooks: losses, approvals and completions are sent to other systems by signed HTTP requests.

    topics     which events are sent, and under which topic
    signing    what a receiver checks
    hooks      registered ones in the database, each with the number of the last event that its receiver has
    delivery   sends what comes after that number, in order, until the receiver has taken it

At least once: events are in the database before they are sent, and a hook's number is raised after its receiver has
answered, so what a killed service had not finished is sent again by the next one. It may import `common`, `store` and
`flights`. Secrets are never returned and never logged, and neither are addresses, which may hold some.
"""
