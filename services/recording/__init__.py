"""Recordings of a run: writing, reading, recovering and exporting MCAP files.

Written    segments (the files of one run), writer (one file), history (what a late page asks for)
Read       records (of any MCAP file, also a damaged one), reader (messages), recover, export, info, node_settings
Counted    acceptance (does a message count?), loss_accounting (by key and by process)
"""
