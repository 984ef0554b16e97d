"""The tabletop benchmark: methods, protocols, the uncertainty card, engines, tables and figures."""
