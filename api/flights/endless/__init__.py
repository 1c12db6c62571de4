"""Operations without a fixed end: the plan in force is extended again and again, and what is remembered stays bounded.

    terms           what the operator asks: how far ahead it is planned, how often, and until when
    horizon         how far the plan in force reaches, how far the next one shall, and when that is due
    keeper          requests the extensions, one incident after the other
    long_record     keeps the newest slots in memory, and in the database all rates and a thinned track
    relief_terms    what the operator gives so that vehicles relieve each other
    pool            the vehicles, the stations that they keep manned, and the crossings between plans
    observing       brings the states of a pool up to date from what vehicles report
    gauges          what each vehicle has used, how much dearer than the model it flies, and who has to come home
    rota_keeper     who relieves whom and when (`planner.rota`), reckoned anew as the pool changes
    dispatcher      sends vehicles up by the rota, requests the reliefs, and calls home who was not relieved
    sortie          one vehicle leaves its pad while others fly
    relieving       one relief: what its replan is given
    relief_view     what clients see of all that

An extension is an ordinary incident (`flights.incidents`) whose cause is `extended`, and a relief one whose cause is
`relief`: they are in the journal, their plans are checked, their missions are swapped, and a restart settles them, as
after a loss. The missions on board always end with a return or a landing, so that vehicles of a service that died come
home in order.
"""
