"""Rigid and scripted bodies as level sets: shapes, their motion, friction. Snow and elastic solids share them."""
