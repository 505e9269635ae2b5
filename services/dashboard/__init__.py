"""Live page: plots and status of a bus in a browser, and command buttons for clients that hold the token."""
