"""Constraints of the lanes engine: contacts, joint limits and dry friction, and the Newton solver that satisfies them.

`contacts` finds contacts with planes, `body_contacts` those between bodies, `dof_constraints` limits and friction of
joints; `cones` has the forces of a contact and `solver` minimises MuJoCo's cost over the accelerations, with `coupled`
where contacts join branches of the tree.
"""
