"""The web server of a site: page, HTTP API and live streams.

site file -> door (hosts, origins, tokens, rates) -> app (api, live, control, page)
                      feed <~~ poses and status of the edge
"""
