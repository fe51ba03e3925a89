"""`pouct_paper`: the planner of the paper. PO-UCT over actions <container, object> with Algorithm 1's outcomes.

Free robots are assigned one after the other in the tree, each by UCB1 (Auer et al. 2002) over all pairs that may help;
robots under way keep their action. A leaf is worth the time so far plus a lower bound on the rest. The paper does not
say which; ours is what the rest would take on average if the contents were told and all objects fetched at once. (The
bound that puts every object at its nearest possible container was tried first: it cannot tell likely from unlikely
containers and led to costs no better than the non-learned baseline's.) The plan is the joint action of least mean cost.
"""

from dataclasses import replace
from time import perf_counter

import numpy as np

from mrtask.planning import paper_kernel as kernel
from mrtask.planning.problem import ANY_SAFE, WAIT, Assignment, FloatArray, Plan, PlanInfo, PlanningProblem, needed
from mrtask.planning.team import stuck_penalty_s
from mrtask.planning.tree import (
    NODES,
    NONE,
    SearchOptions,
    Tree,
    edges_of,
    empty_tree,
    mean_cost_s,
    root_statistics,
    run_search,
)
from mrtask.tasks.automaton import Automaton

MAX_OBJECTS = 30
MAX_SETS = 4096
MIN_PROB = 1e-6
"""Likelihood of an object in each container open to search where the given ones say that it is nowhere."""


class PaperOptions(SearchOptions):
    """Options of `pouct_paper`, under ``planner.pouct_paper`` in the configuration."""


class PaperPouct:
    """The paper's search planner; see the module."""

    knows_contents = False

    def __init__(self, options: PaperOptions) -> None:
        self.options = options

    def warm_up(self, problem: PlanningProblem) -> None:
        """Compiles the kernels: one sample."""
        PaperPouct(replace(self.options, samples=1)).plan(problem, seed=0)

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """Searches from the problem's belief; ``seed`` starts the random numbers of the samples.

        Raises:
            ValueError: more task objects than the kernel's bit masks hold.
        """
        began_s = perf_counter()
        free = [index for index, robot in enumerate(problem.robots) if robot.free]
        if problem.automaton.accepting[problem.state] or not free:
            return Plan({index: Assignment(WAIT) for index in free})
        options = self.options
        model, root = paper_model(problem), root_belief(problem)
        belief = blank_belief(problem)
        tree = empty_tree(options)
        kernel.decision_node(root, tree, NONE)
        rng = np.array([seed], dtype=np.uint64)
        containers, objects = model.prob.shape
        scratch = kernel.Scratch(np.empty(containers), np.empty(containers, dtype=np.int32), np.empty(objects))
        done = run_search(
            options,
            run=lambda count: kernel.run_samples(model, root, belief, tree, options.exploration, rng, count, scratch),
        )
        info = PlanInfo(
            planning_s=perf_counter() - began_s,
            samples=done,
            tree_nodes=int(tree.size[NODES]),
            value_s=mean_cost_s(tree, _cheapest(tree, 0)),
            root=root_statistics(tree, lambda action: _assignment(action, objects)),
        )
        return Plan(_joint_action(problem, tree, free), info)


def paper_model(problem: PlanningProblem) -> kernel.PaperModel:
    """What does not change while planning, in the kernel's terms.

    Raises:
        ValueError: more task objects than the kernel's bit masks hold.
    """
    objects = problem.presence_prob.shape[1]
    if objects > MAX_OBJECTS:
        raise ValueError(f"pouct_paper handles tasks of up to {MAX_OBJECTS} objects, this one has {objects}")
    automaton = problem.automaton
    bits = 1 << np.arange(objects)
    away_s = np.array([robot.travel_s for robot in problem.robots])
    return kernel.PaperModel(
        travel_s=np.ascontiguousarray(problem.travel_s, dtype=np.float64),
        away_s=away_s,
        prob=_search_prob(problem),
        transitions=automaton.transitions.astype(np.int32),
        accepting=automaton.accepting.astype(np.uint8),
        advancing=(automaton.advancing * bits).sum(axis=1).astype(np.int64),
        needed=(needed(automaton) * bits).sum(axis=1).astype(np.int64),
        sufficient=sufficient_sets(automaton),
        search_time_s=float(problem.search_time_s),
        interact_time_s=float(problem.interact_time_s),
        penalty_s=stuck_penalty_s(problem),
    )


def root_belief(problem: PlanningProblem) -> kernel.PaperBelief:
    """What the team knows and does now, in the kernel's terms."""
    bits = 1 << np.arange(problem.presence_prob.shape[1])
    known = np.where(problem.presence_prob > 0, kernel.PRESENT, kernel.ABSENT)
    known[~problem.searched] = kernel.UNKNOWN
    root = blank_belief(problem)
    root.known[:] = known
    root.searched[:] = problem.searched
    root.state[kernel.AUTOMATON] = problem.state
    root.state[kernel.LOCATED] = (problem.found() * bits).sum()
    for index, robot in enumerate(problem.robots):
        root.place[index] = robot.place
        if robot.free:
            root.undecided[index] = 1
        elif robot.target >= 0:
            searching_s = 0.0 if problem.searched[robot.target] else problem.search_time_s
            _put(root, index, robot.target, robot.interaction, robot.remaining_s + searching_s, problem)
        elif robot.interacting >= 0:
            _put(root, index, robot.place, robot.interacting, robot.remaining_s - problem.interact_time_s, problem)
        else:
            _put(root, index, robot.place, robot.interaction, robot.remaining_s, problem)
    return root


def _search_prob(problem: PlanningProblem) -> FloatArray:
    """[C, O] the likelihoods in unsearched containers. An object with none above 0 is looked for all the same."""
    reachable = np.isfinite([robot.travel_s for robot in problem.robots]).any(axis=0)
    unsearched = ~problem.searched & reachable
    prob = np.where(unsearched[:, None], problem.presence_prob, 0.0)
    nowhere = ~problem.found() & (prob == 0.0).all(axis=0)
    return np.where(unsearched[:, None] & nowhere, MIN_PROB, prob)


def sufficient_sets(automaton: Automaton) -> kernel.I8:
    """[Z, S] for each state the minimal sets of objects (bit masks) along which advancing steps accept; padded by -1.

    Raises:
        ValueError: more than `MAX_SETS` minimal sets for one state.
    """
    sets: list[set[int]] = [{0} if accepting else set() for accepting in automaton.accepting]
    changed = True
    while changed:
        changed = False
        for state, advancing in enumerate(automaton.advancing):
            grown = set(sets[state])
            for obj in np.flatnonzero(advancing):
                grown |= {members | (1 << int(obj)) for members in sets[automaton.transitions[state, obj]]}
            minimal = {one for one in grown if not any(other != one and other & one == other for other in grown)}
            if len(minimal) > MAX_SETS:
                raise ValueError(f"more than {MAX_SETS} ways to complete the task; simplify the formula")
            if minimal != sets[state]:
                sets[state], changed = minimal, True
    table = np.full((len(sets), max(1, *map(len, sets))), NONE, dtype=np.int64)
    for state, members in enumerate(sets):
        table[state, : len(members)] = sorted(members)
    return table


def _put(root: kernel.PaperBelief, robot: int, place: int, obj: int, arrive_s: float, problem: PlanningProblem) -> None:
    """Sets a robot's action under way; one that names no object (not this planner's) is taken for the first needed."""
    root.place[robot] = place
    root.obj[robot] = obj if obj != ANY_SAFE else int(np.argmax(needed(problem.automaton)[problem.state]))
    root.arrive_s[robot] = arrive_s
    root.done_s[robot] = arrive_s + problem.interact_time_s


def blank_belief(problem: PlanningProblem) -> kernel.PaperBelief:
    """A belief of the problem's size, to be overwritten."""
    (containers, objects), robots = problem.presence_prob.shape, len(problem.robots)
    return kernel.PaperBelief(
        clock=np.zeros(1),
        state=np.zeros(2, dtype=np.int64),
        known=np.zeros((containers, objects), dtype=np.uint8),
        searched=np.zeros(containers, dtype=np.uint8),
        place=np.full(robots, NONE, dtype=np.int32),
        obj=np.full(robots, NONE, dtype=np.int32),
        arrive_s=np.zeros(robots),
        done_s=np.zeros(robots),
        undecided=np.zeros(robots, dtype=np.uint8),
    )


def _cheapest(tree: Tree, node: int, allow_wait: bool = True) -> int:
    """The edge of least mean cost, NONE if there is no such edge."""
    edges = [edge for edge in edges_of(tree, node) if allow_wait or tree.action[edge] != kernel.WAIT]
    return min(edges, key=lambda edge: mean_cost_s(tree, edge), default=NONE)


def _joint_action(problem: PlanningProblem, tree: Tree, free: list[int]) -> dict[int, Assignment]:
    """Follows the edges of least mean cost through the free robots; robots the tree did not reach wait.

    Somebody acts if anybody can: where the whole team would wait, the first robot takes its cheapest other action.
    """
    objects = problem.presence_prob.shape[1]
    assignments = {index: Assignment(WAIT, 0) for index in free}
    under_way = len(free) < len(problem.robots)
    node = 0
    for _ in free:
        edge = _cheapest(tree, node) if node != NONE else NONE
        if edge == NONE:
            break
        action = int(tree.action[edge])
        assignments[int(tree.robot[node])] = _assignment(action, objects)
        node = int(tree.first_child[edge])
    edge = _cheapest(tree, 0, allow_wait=False)
    if edge != NONE and not under_way and all(chosen.container == WAIT for chosen in assignments.values()):
        assignments[int(tree.robot[0])] = _assignment(int(tree.action[edge]), objects)
    return assignments


def _assignment(action: int, objects: int) -> Assignment:
    return Assignment(WAIT, 0) if action == kernel.WAIT else Assignment(*divmod(action, objects))
