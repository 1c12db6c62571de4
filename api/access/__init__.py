"""Who may use the service: API keys with roles, the limit on wrong keys, and the audit log.

    api_keys      keys, stored as digests; the roles viewer, planner and pilot
    key_attempts  identifies a key, and limits the wrong ones that an address may try
    audit_log     who changed what, and who was refused

It may import `common` and `store`. It knows nothing of HTTP: `http/middleware.py` reads the headers and calls it. A key
is shown once, when it is created; neither logs nor the database ever hold one. Which role a route needs is said at the
route (`http/routes/deps.py`, `requires`).
"""
