"""Wirtinger's inequality for the held error: decay for every T_k <= tau_max, for a given gain and for a found one."""
