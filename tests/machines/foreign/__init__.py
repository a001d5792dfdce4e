"""Foreign CiA 402 drives behind a foreign wire in virtual time, and a judge that sees the plant alone.

Nothing of the product is imported here: a command of it runs in processes of its own, and finds the wire as
a python-can interface (`foreign`). See `cell.py`.
"""
