"""The dashboard at `/ui`: see the fleet, the rates and the loss, and act.

It knows the service by its REST and event surface alone: `rest.py` calls it in process, `feed.py` is the one facade
that turns its JSON into the typed views of `views.py`. `watch.py` keeps the picture of the running operation fresh
while somebody looks; `picture.py`, `schedule.py` and `charts.py` are pure: views in, what is drawn out. `pages/` are
the pages, `components/` the canvas map and the fleet table that run in the browser, `mount.py` joins it to the app.
Nothing is loaded from elsewhere: it works offline.
"""
