"""What is kept of a site, for the page: files made of its store, and its recordings.

request (form, time, people) -> jobs (a queue, a folder, one child at a time) -> making (child)
"""
