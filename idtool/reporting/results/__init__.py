"""The results of the commands as typed records: what JSON files hold, functions return, pages and terminal show.

The field descriptions are the reference of the JSON files, which `docs/reference.py` makes, with the JSON schemas.
"""
