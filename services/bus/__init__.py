"""Message bus.

topics              what travels, and who writes and reads it
wire                encoding and decoding of one message
message_validation  acceptance or rejection of each received frame
sequence_check      epoch and sequence number
outbox, mailbox, latest_cache   publishing, and the queue and cache of received frames
session             Zenoh
roles, security, certificates, denials   who may write and read what on a secured bus
schema, protocol    JSON schemas and the protocol page
"""
