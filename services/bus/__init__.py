"""Message bus.

What travels      topics (table of keys, writers and readers), schema (their description for others)
One message       wire (encoding, decoding), message_validation (accepted or rejected), sequence_check (its order)
One process       session and options (Zenoh), outbox and mailbox (published and received frames)
Security          roles (who may write and read what), security and certificates (TLS), denials (rejected attempts)
"""
