"""Operations: plans flown by vehicles of the fleet, from upload to landing, and what is done when a UAV is lost.

    operations, operation, operation_record         all operations; one of them; its state, as stored and shown
    operation_store, operation_views                its rows in the database, and what clients see
    flight, flight_timeline, take_off, roster, ends the vehicles: commands, slot clock, take-off, who counts, ends
    guidance, schedule_keepers, setpoint_streams    missions or setpoints, and keeping UAVs on schedule
    assigned_missions, missions_on_board            what was sent to each UAV, and what it therefore may fly
    losses, incidents, recovery, plans_ahead        a loss, what is done about it, and plans made before it
    swap, transition                                the way of the survivors into a new plan
    airspace, traffic, ghost_clearance              the air of all operations, and that of UAVs that were lost
    journal, restart                                the steps of incidents, and how a restart goes on from them
    orders, aborts, stragglers, drills              orders of the operator, ends by order, late landings, practice
    rates, flown_rates, track                       what users got, and who was where
    radio, allocations                              whom base stations must serve, and who serves users of a lost UAV
    endless                                         operations without a fixed end, and vehicles that relieve each other
    base_stations, own_stations                     those of simulated vehicles, and those of the service's own fleet
    measured_rates, rates_watch                     what users were measured to get, and when that calls for a new plan

It may import `common`, `store`, `plans` and `fleet` (`tests/test_floors.py`). A step that reaches a vehicle is in the
journal before it is sent: a change that adds one keeps to that, and adds it to the kill matrix
(`tests/api/test_killed.py`).
Stored documents, journal steps and event kinds keep their names: restarts and clients read them.
"""
