"""The door of a site for people and other programs: one HTTP server for page, API and streams.

site file -> door (hosts, origins, tokens, rates) -> app (api, live, control, page)
                      feed <~~ poses and status of the edge
"""
