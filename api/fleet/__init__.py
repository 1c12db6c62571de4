"""Vehicles: the registry, the one link to all of them, and what is known of each, whether an operation flies it or not.

    registry, vehicle_view            which UAV of a plan is which MAVLink system, and each vehicle as clients see it
    fleet_connection, vehicle_news    the link, and what it reports: events, conditions, doubts about senders
    commander, order_rules            commands and emergency orders, and which vehicles an order leaves alone
    own_link                          whether a silence is a vehicle's or our own link's
    simulated_fleet                   vehicles in software inside the service, for drills
    vehicle_check, trial_mission      the check of an operator's own vehicles on the ground

It may import `common` and `store`, and knows neither plans nor operations (`tests/test_floors.py`). A command to a
vehicle in flight goes through `Fleet.commander`: sent past it, it would not be ended by an emergency order. The bridge
decides what condition a vehicle is in; here that is kept, and reported once.
"""
