"""Operations without a fixed end: the plan in force is extended again and again, and what is remembered stays bounded.

    terms           what the operator asks: how far ahead it is planned, how often, and until when
    horizon         how far the plan in force reaches, how far the next one shall, and when that is due
    keeper          requests the extensions, one incident after the other
    long_record     keeps the newest slots in memory, and in the database all rates and a thinned track

An extension is an ordinary incident (`flights.incidents`) whose cause is `extended`: it is in the journal, its plan is
checked, its missions are swapped, and a restart settles it, as after a loss. The missions on board always end with a
return or a landing, so that vehicles of a service that died come home in order.
"""
