"""The dashboard at `/ui`: see the fleet, the rates and the losses, and act.

It sees the service as any client does, through its REST interface and event stream. `rest.py` calls them in process
with the operator's key, and `feed.py` is the only module that knows routes and JSON; it returns the typed `views.py`.
`port.py` holds the few names that the dashboard shares with `http/`: only `http/app.py` mounts the dashboard, and
nothing else of the service imports it. `watch.py` keeps the state of the running operation current while somebody
looks. `map_scene.py`, `schedule.py`, `charts.py`, `recoveries.py`, `event_text.py` and `report.py` are pure: views in,
what is drawn or written out; put new logic there and test it without a browser. `pages/` are the pages, `components/`
the map and the fleet table that run in the browser, and `mount.py` joins everything to the app. Nothing is loaded from
elsewhere, so that it works offline. Texts use the words of docs/glossary.md.
"""
