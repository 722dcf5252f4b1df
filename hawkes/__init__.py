"""Networks: who took part in events whose participants are unknown (Part I of the source)."""
