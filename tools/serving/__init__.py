"""The service: `contramap serve`, its messages and a client."""
