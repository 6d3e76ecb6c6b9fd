from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl.algorithm import (
    begin,
    episode,
    expected,
    hallucinated,
    learn,
    number_of,
    practised,
    propose,
    restart,
    scored,
)
from hiprl.control.plan import Follow, Mpc, PlanConfig
from hiprl.data.answer import number
from hiprl.errors import FitDiverged
from hiprl.models.dynamics import estimate_dynamics
from hiprl.reported import best_actor, confirmed
from hiprl.world.build import world_from
from hiprl.world.task import World
from tests.whole.tasks import DREAMING, TINY, exactly

PRACTISING = [replace(TINY, comparisons=4, practice=1), replace(TINY, comparisons=4, warm_up=4, practice=2)]
assert {config.trajectories for config in (TINY, DREAMING, *PRACTISING)} == {7}  # the same shapes: little to compile


class Spy(World):
    """Another world, which notes the key of each episode."""

    def __init__(self, world):
        self.world, self.keys = world, []
        self.name, self.p, self.q, self.H = world.name, world.p, world.q, world.H
        self.terminates, self.ends = world.terminates, world.ends

    def roll_out(self, actor, *, key):
        self.keys.append(tuple(np.asarray(jr.key_data(key)).tolist()))
        return self.world.roll_out(actor, key=key)

    def spec(self):
        return None


def data(key):
    return tuple(np.asarray(jr.key_data(key)).tolist())


def ask(question, run, *, key):
    return exactly(question, run, key=key)


@pytest.fixture(scope="module")
def world():
    return Spy(world_from("linear"))


@pytest.fixture(scope="module")
def runs(world):
    """What is known before and after each episode, and the episodes."""
    known, done = [begin(world, TINY, key=jr.key(5))], []
    for _ in range(TINY.comparisons):
        done.append(episode(known[-1], world, TINY, ask, key=jr.key(5)))
        known.append(done[-1].run)
    return known, done


def same(x, y):
    return all(
        np.array_equal(a, b, equal_nan=True) for a, b in zip(jax.tree.leaves(x), jax.tree.leaves(y), strict=True)
    )


def test_a_run_begins_with_one_random_trajectory_and_no_answer(runs, world):
    first = runs[0][0]
    assert int(first.k) == 0 and int(first.T.count) == 1 and int(first.P.count) == 0
    assert not first.archive.filled.any()
    assert first.T.capacity == TINY.comparisons + 1 and first.P.capacity == TINY.comparisons


def test_each_episode_adds_one_trajectory_and_one_answer(runs):
    for k, run in enumerate(runs[0]):
        assert int(run.k) == k and int(run.T.count) == k + 1 and int(run.P.count) == k


def test_the_warm_up_is_random_and_the_rest_is_searched(runs):
    known, done = runs
    # τ_0 is the first of the warm-up's trajectories
    assert [x.question.attempt.searched for x in done] == [k >= TINY.warm_up for k in range(1, TINY.comparisons + 1)]
    np.testing.assert_array_equal(known[-1].archive.filled, np.arange(TINY.comparisons + 1) >= TINY.warm_up)


def test_comparisons_in_the_warm_up_count(runs):
    assert sum(not done.question.attempt.searched for done in runs[1]) == TINY.warm_up - 1
    assert int(runs[0][-1].P.count) == TINY.comparisons


def test_each_new_trajectory_is_compared_with_an_older_one(runs):
    P = runs[0][-1].P
    np.testing.assert_array_equal(P.first, np.arange(1, TINY.comparisons + 1))
    assert (np.asarray(P.second) < np.asarray(P.first)).all()


def test_answers_are_differences_of_true_returns(runs):
    run = runs[0][-1]
    returns = np.asarray(run.T.rows.rewards).sum(1)
    by_hand = returns[np.asarray(run.P.first)] - returns[np.asarray(run.P.second)]
    np.testing.assert_allclose(run.P.g, by_hand, rtol=1e-4, atol=1e-4)


def test_an_episode_is_cut_at_its_question(runs, world):
    known, done = runs
    k = 4
    propose_key, learn_key = jr.split(jr.key(1))
    question = propose(known[k], world, TINY, key=propose_key)
    assert same(question, propose(known[k], world, TINY, key=jr.split(jr.key(1))[0]))
    new, older = question.clips.of
    assert int(new) == k + 1 and int(older) <= k
    assert question.tau.actions.shape == done[k].question.tau.actions.shape
    after = learn(known[k], question, number(2.5), world, TINY, key=learn_key)
    assert int(after.k) == k + 1 and float(after.P.g[k]) == 2.5 and same(after.T.get(k + 1), question.tau)


def test_proposing_changes_nothing_that_is_known(runs, world):
    before = jax.tree.map(np.array, runs[0][4])
    propose(runs[0][4], world, TINY, key=jr.key(99))
    assert same(before, runs[0][4])


def test_another_answer_makes_another_reward_and_the_same_dynamics(runs, world):
    known, done = runs
    one = learn(known[4], done[4].question, number(3.0), world, TINY, key=jr.key(1))
    other = learn(known[4], done[4].question, number(-40.0), world, TINY, key=jr.key(1))
    assert same(one.dynamics, other.dynamics) and not same(one.reward, other.reward)


def test_the_policy_kept_is_the_one_whose_trajectory_the_reward_ranks_best(runs, world):
    run = runs[0][-1]
    returns = np.asarray(run.reward.returns(run.T))
    searched = np.flatnonzero(run.archive.filled)
    best = searched[np.argmax(returns[searched])]
    actor = best_actor(run, world, TINY)
    assert isinstance(actor, Follow) and not actor.explore
    assert same(actor.policy, run.archive.get(int(best)).policy)


def upside_down(run):
    """The run with a reward that wants the opposite."""
    return eqx.tree_at(lambda run: run.reward.mean, run, -run.reward.mean)


def test_a_reward_that_wants_the_opposite_keeps_another_policy(runs, world):
    run = runs[0][-1]
    returns = np.asarray(run.reward.returns(run.T))
    searched = np.flatnonzero(run.archive.filled)
    worst = searched[np.argmin(returns[searched])]
    assert same(best_actor(upside_down(run), world, TINY).policy, run.archive.get(int(worst)).policy)


def test_the_true_return_decides_nothing(runs, world):
    run = runs[0][-1]
    rewards = jnp.flip(run.T.rows.rewards) * 100
    other = eqx.tree_at(lambda run: run.T.rows.rewards, run, rewards)
    assert same(best_actor(other, world, TINY), best_actor(run, world, TINY))
    assert same(restart(other, TINY), restart(run, TINY))


def test_a_search_begins_at_the_best_or_at_the_newest_policy(runs):
    run = runs[0][-1]
    run = eqx.tree_at(lambda run: run.archive.filled, run, run.T.filled)  # nothing random is left to be worse than
    either = run, upside_down(run)  # the newest is the best of at most one of them
    best = lambda run: int(run.archive.best(run.reward.returns(run.T)))
    run = min(either, key=best)
    best = best(run)
    state, setbacks = restart(run, TINY)
    assert same(state, run.archive.get(best)) and int(setbacks) == TINY.comparisons - best > 0
    state, setbacks = restart(run, replace(TINY, restart=False))
    assert same(state, run.archive.get(TINY.comparisons)) and int(setbacks) == 0


def test_a_search_begins_anew_where_the_best_policy_stays_worse_than_random_actions(runs):
    run = runs[0][-1]
    searched = np.asarray(run.archive.filled)
    first = int(np.flatnonzero(searched)[0])

    class Told(type(run.reward)):
        """A reward that pays trajectories as it is told."""

        told: jax.Array

        def returns(self, T):
            return self.told

    def begins(random, policies):
        returns = np.full(len(searched), random, float)
        returns[searched] = policies
        parts = {name: getattr(run.reward, name) for name in run.reward.__dataclass_fields__}
        reward = Told(**parts, told=jnp.asarray(returns, jnp.float32))
        return restart(eqx.tree_at(lambda run: run.reward, run, reward), TINY)

    n = int(searched.sum())
    worse = [-5.0, *[-9.0] * (n - 1)]  # the first policy is the best of them, and no later one was better
    state, setbacks = begins(0.0, worse)
    assert same(state, run.archive.get(0)) and int(setbacks) == 0
    state, setbacks = begins(-7.0, worse)  # random actions were worse still
    assert same(state, run.archive.get(first)) and int(setbacks) == n - 1
    state, setbacks = begins(0.0, worse[::-1])  # the newest one is the best: that may go on
    assert same(state, run.archive.get(run.T.last)) and int(setbacks) == 0


def test_the_first_search_has_no_setbacks(runs):
    state, setbacks = restart(runs[0][TINY.warm_up - 1], TINY)
    assert same(state, runs[0][0].archive.get(0)) and int(setbacks) == 0


class Scripted(World):
    """A world in which the policy behind each trajectory fares as the trajectories in its list did, in turn."""

    def __init__(self, world: World, run, fate: dict[int, list[int]]):
        self.name, self.p, self.q, self.H, self.run = world.name, world.p, world.q, world.H, run
        self.terminates, self.ends = world.terminates, world.ends
        self.fate, self.log = {i: list(seen) for i, seen in fate.items()}, []
        self.keys: dict[int, list[bytes]] = {i: [] for i in fate}

    def roll_out(self, actor, *, key):
        assert isinstance(actor, Follow) and not actor.explore
        (i,) = (i for i in self.fate if same(actor.policy, self.run.archive.get(i).policy))
        self.log.append(i)
        self.keys[i].append(np.asarray(jr.key_data(key)).tobytes())
        seen = self.fate[i]
        return self.run.T.get(seen.pop(0) if len(seen) > 1 else seen[0])

    def spec(self):
        return None


def ranked(run):
    """The trajectories with a policy behind them, the worst by r̂ first."""
    returns = np.where(run.archive.filled, run.reward.returns(run.T), -np.inf)
    return [int(i) for i in np.argsort(returns)[-int(np.sum(run.archive.filled)) :]]


def test_a_policy_that_was_lucky_once_is_found_out(runs, world):
    run = runs[0][-1]
    worst, *others, second, best = ranked(run)
    usual = {i: [i] for i in (worst, *others)}
    lucky = Scripted(world, run, {**usual, second: [second], best: [worst]})
    chosen, steps = confirmed(run, lucky, replace(TINY, confirmations=3), key=jr.key(0))
    assert int(chosen) == second and int(steps) == 2 * 31 and lucky.log == [best, second]
    twice = Scripted(world, run, {**usual, second: [second], best: [best, worst]})
    chosen, _ = confirmed(run, twice, replace(TINY, confirmations=4), key=jr.key(0))
    assert int(chosen) == second and twice.log == [best, second, best, second]
    true = Scripted(world, run, {**usual, second: [second], best: [best]})
    chosen, steps = confirmed(run, true, TINY, key=jr.key(0))
    assert int(chosen) == best and int(steps) == 31 * TINY.confirmations


def test_the_better_half_is_executed_more_often(runs, world):
    run = runs[0][-1]
    *_, fourth, third, second, best = ranked(run)
    fate = Scripted(world, run, {best: [fourth], second: [third], third: [best], fourth: [second]})
    chosen, steps = confirmed(run, fate, replace(TINY, confirmations=20), key=jr.key(0))
    assert int(chosen) == third and int(steps) == 20 * 31
    assert [fate.log.count(i) for i in (best, second, third, fourth)] == [2, 2, 8, 8]
    assert [fate.keys[i][:2] for i in (second, third, fourth)] == [fate.keys[best]] * 3  # all meet the same


def test_one_policy_alone_is_not_executed_again(runs, world):
    run = runs[0][TINY.warm_up]
    assert len(ranked(run)) == 1
    chosen, steps = confirmed(run, Scripted(world, run, {}), replace(TINY, confirmations=20), key=jr.key(0))
    assert int(chosen) == ranked(run)[0] and int(steps) == 0


def test_without_confirmations_the_rank_of_the_one_episode_counts(runs, world):
    run = runs[0][-1]
    chosen, steps = confirmed(run, Scripted(world, run, {}), replace(TINY, confirmations=0), key=jr.key(0))
    assert int(chosen) == ranked(run)[-1] and int(steps) == 0


def test_what_is_executed_is_the_policy_and_some_noise(runs, world):
    question = runs[1][-1].question
    tau, policy = question.tau, question.attempt.state.policy
    off = np.asarray(tau.actions - jax.vmap(policy.mode)(tau.states[:-1])[:, : world.q])[: int(tau.length)]
    assert 0.03 < off.std() < 0.15 and np.abs(off).max() < 0.6


def test_a_run_that_plans_keeps_its_planner(runs, world):
    actor = best_actor(runs[0][-1], world, replace(TINY, plan=PlanConfig(kind="mpc")))
    assert isinstance(actor, Mpc)
    drawn = best_actor(runs[0][-1], world, replace(TINY, plan=PlanConfig(kind="sample")))
    assert isinstance(drawn, Follow) and not drawn.explore


def test_an_answer_is_expected_by_the_reward_that_did_not_know_it(runs):
    known, done = runs
    question, g = done[4].question, number_of(done[4].answer)
    gap = known[4].reward.gap(question.tau, known[4].T.get(question.clips.of[1]))
    assert float(expected(known[4], question).mean) == pytest.approx(float(gap.mean), rel=1e-3, abs=1e-3)
    z = abs(float(g) - float(gap.mean)) / float(gap.sigma)
    count = int(known[4].calibration.count)
    assert float(known[5].calibration.z[count]) == pytest.approx(z, rel=1e-2)


def test_a_prediction_before_any_answer_does_not_count(runs):
    known, done = runs
    assert np.isnan(expected(known[0], done[0].question).mean)
    after = known[1].calibration
    assert int(after.count) == 0 and float(after.alpha) == 1
    assert float(known[-1].calibration.alpha) < 1e3


def test_an_episode_is_scored_by_the_models_that_did_not_know_it(runs):
    known, done = runs
    scores = scored(known[4], done[4].question.attempt, TINY)
    np.testing.assert_array_equal(known[5].calibration.beta, scores.errors.beta)
    assert float(scores.errors.deviation) > 0


def promising(new, promised):
    return eqx.tree_at(lambda new: new.report.imagined, new, jnp.asarray(promised))


def test_kappa_is_halved_when_imagination_promised_over_three_times_too_much(runs):
    known, done = runs
    new = done[4].question.attempt
    executed = float(scored(known[4], new, TINY).executed)
    before = float(known[4].calibration.kappa)
    kept = scored(known[4], promising(new, executed + 2.9 * abs(executed)), TINY)
    broken = scored(known[4], promising(new, executed + 3.1 * abs(executed)), TINY)
    assert not kept.overpromised and float(kept.calibration.kappa) == pytest.approx(before)
    assert broken.overpromised and float(broken.calibration.kappa) == pytest.approx(before / 2)


def test_the_executed_return_is_over_as_many_steps_as_the_trial(runs):
    known, done = runs
    new = done[4].question.attempt
    s, a = (np.asarray(x)[: TINY.search.trial_steps] for x in (new.tau.states, new.tau.actions))
    r = jax.vmap(known[4].reward)(jnp.asarray(s), jnp.asarray(a))
    assert float(scored(known[4], new, TINY).executed) == pytest.approx(float(np.sum(r)), rel=1e-3)


@pytest.mark.parametrize("config", PRACTISING)
def test_practice_adds_trajectories_that_nobody_is_asked_about(runs, world, config):
    run = begin(world, config, key=jr.key(5))
    for k in range(1, config.comparisons + 1):
        done = episode(run, world, config, ask, key=jr.key(5))
        run = practised(done.run, world, config, key=jr.key(5))
        assert int(run.T.count) == config.number_after(k) == k + 1 + config.practice * max(0, k - config.warm_up + 1)
        assert int(done.question.clips.of[0]) == config.number_after(k - 1)  # it is about its own episode
    assert int(run.P.count) == config.comparisons and int(run.T.count) == run.T.capacity
    np.testing.assert_array_equal(run.archive.filled, np.arange(run.T.capacity) >= config.warm_up)
    assert same(run.T.get(TINY.warm_up - 1), runs[0][-1].T.get(TINY.warm_up - 1))  # the warm-up is the same


@pytest.fixture(scope="module")
def dreamt():
    """Episodes of a run that is asked about what was imagined, too, and what is known after them."""
    world, config, done = world_from("linear"), DREAMING, []
    run = begin(world, config, key=jr.key(6))
    for _ in range(config.comparisons):
        done.append(episode(run, world, config, ask, key=jr.key(6)))
        run = done[-1].run
    return run, done, config, world


def test_what_is_imagined_stands_before_the_episode_of_its_policy(dreamt):
    run, done, config, _ = dreamt
    real = np.asarray(run.T.real)
    first = config.warm_up
    np.testing.assert_array_equal(real, [True] * first + [False, True] * (config.comparisons + 1 - first))
    assert int(run.T.count) == run.T.capacity == config.number_after(config.comparisons)
    assert [int(x.run.T.count) for x in done] == [config.number_after(k) for k in range(1, config.comparisons + 1)]
    np.testing.assert_array_equal(run.archive.filled, real & (np.arange(run.T.capacity) >= first))


def test_what_is_imagined_follows_the_model_and_is_priced_by_the_world(dreamt):
    _, done, config, world = dreamt
    new, before = done[config.warm_up - 1].question.attempt, done[config.warm_up - 2].run
    tau = jax.tree.map(np.asarray, new.dream)
    firsts = np.asarray(before.T.rows.states[: int(before.T.count), 0])
    assert tau.imagined and not new.tau.imagined and (firsts == tau.states[0]).all(axis=1).any()
    policy = jax.vmap(new.state.policy.mode)(jnp.asarray(tau.states[:-1]))
    np.testing.assert_allclose(tau.actions, policy, atol=1e-5)
    np.testing.assert_allclose(tau.rewards, jax.vmap(world.task.r)(tau.states[:-1], tau.actions), rtol=1e-5)
    belief = jax.vmap(before.dynamics.ensemble.predict)(jnp.asarray(tau.states[:-1]), jnp.asarray(tau.actions))
    off = np.abs(tau.states[1:] - belief.mu) / np.sqrt(np.square(belief.sigma) + np.square(belief.noise))
    assert np.median(off) < 2  # a member's step, and noise, about the mean of all


def test_the_world_is_learned_from_what_was_executed_alone(dreamt):
    run, _, config, world = dreamt
    # they begin where others do, and that is real
    dreamt = run.T.rows.imagined[:, None, None] & (jnp.arange(world.H + 1)[None, :, None] > 0)
    wild = jnp.where(dreamt, 1e3, run.T.rows.states)
    changed = eqx.tree_at(lambda run: run.T.rows.states, run, wild)
    assert not same(changed.T, run.T)
    found = hallucinated(run, world, config), hallucinated(changed, world, config)
    assert same(*found)  # the box, too
    fitted = [
        estimate_dynamics(x.T.executed(), x.dynamics, config.dynamics, steps=50, key=jr.key(1)) for x in (run, changed)
    ]
    assert same(*fitted)


def test_a_search_begins_at_a_policy_that_was_executed(dreamt):
    run, _, config, _ = dreamt
    tried = np.asarray(run.archive.filled)

    class Told(type(run.reward)):
        told: jax.Array

        def returns(self, T):
            return self.told

    def begins(returns):
        parts = {name: getattr(run.reward, name) for name in run.reward.__dataclass_fields__}
        reward = Told(**parts, told=jnp.asarray(returns, jnp.float32))
        return restart(eqx.tree_at(lambda run: run.reward, run, reward), config)

    first = int(np.flatnonzero(tried)[0])
    returns = np.where(tried, -9.0, 5.0)  # what was imagined looks better than all, and so do random actions
    returns[: config.warm_up] = -20.0
    returns[first] = -5.0
    state, setbacks = begins(returns)
    assert same(state, run.archive.get(first)) and int(setbacks) == int(tried.sum()) - 1


def test_questions_are_about_what_was_imagined_as_well(dreamt):
    run, done, config, _ = dreamt
    shown = np.asarray(run.P.clips.of)
    assert np.asarray(run.T.rows.imagined)[shown].any()
    newest = [int(x.question.clips.of[0]) for x in done]
    assert newest == [config.number_after(k) - 1 for k in range(1, config.comparisons + 1)]  # as executed


def test_the_first_trajectory_and_the_episodes_draw_from_different_keys(runs, world):
    episodes = {data(jr.fold_in(jr.key(5), k)) for k in range(TINY.comparisons + 1)}
    assert world.keys[0] not in episodes


def test_no_two_episodes_draw_from_the_same_key(runs, world):
    assert len(set(world.keys[: TINY.comparisons + 1])) == TINY.comparisons + 1


def test_random_actions_fill_the_box_in_the_papers_way_only(runs, world):
    first = runs[0][0]
    plain = replace(TINY, babble="uniform")
    reach = lambda config, k: float(jnp.nanmax(jnp.abs(propose(first, world, config, key=jr.key(k)).tau.actions)))
    assert min(reach(plain, k) for k in range(5)) > 0.8
    assert min(reach(TINY, k) for k in range(5)) < 0.5


def test_a_dynamics_model_that_diverges_is_told(runs, world):
    known, done = runs
    wild = replace(TINY, dynamics=replace(TINY.dynamics, learning_rate=1e30))
    run, question = known[TINY.warm_up], done[TINY.warm_up].question
    with pytest.raises(FitDiverged, match=r"smaller learning rate"):
        learn(run, question, number(1.0), world, wild, key=jr.key(0))
