"""Places in and out: users, UAVs, no-fly zones and areas from files of spreadsheets and GIS; plans as such files.

    in     files (what is given) -> geojson, tables, kml (features of each format) -> properties (what they say)
           -> importing, on assembling (features -> scenario); faults (what is wrong, by file, row and column)
    out    outlining (scenario and plan -> features) -> writing (features as GeoJSON, KML or CSV)

Bytes go in and come out: only `reading`, for Python, opens files, and nothing here knows the service. All degrees are
WGS-84, longitude first in GeoJSON, KML and WKT. A new format is a reader that yields `Feature`s, and a row in
`importing.READERS`.
"""
