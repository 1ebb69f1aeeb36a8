//! The designs that no other beats in everything.

/// Places of those for which no other is at least as good in every goal and better in one. Greater is
/// better; whoever wants little of a thing gives it with a minus.
pub fn front<const N: usize>(goals: &[[f64; N]]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..goals.len()).collect();
    order.retain(|i| goals[*i].iter().all(|goal| goal.is_finite()));
    // Nobody is beaten by those who come later, but for equals in the first goal.
    order.sort_by(|a, b| {
        let pairs = goals[*b].iter().zip(&goals[*a]);
        pairs.fold(std::cmp::Ordering::Equal, |order, (b, a)| {
            order.then(b.total_cmp(a))
        })
    });
    let mut front: Vec<usize> = Vec::new();
    for candidate in order {
        if !front
            .iter()
            .any(|one| beats(&goals[*one], &goals[candidate]))
        {
            front.push(candidate);
        }
    }
    front
}

fn beats<const N: usize>(one: &[f64; N], other: &[f64; N]) -> bool {
    one.iter().zip(other).all(|(a, b)| a >= b) && one != other
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn only_the_unbeaten_are_on_the_front() {
        let goals = [
            [1.0, 5.0],
            [2.0, 4.0],
            [2.0, 3.0],
            [0.5, 5.0],
            [3.0, 1.0],
            [f64::NAN, 9.0],
        ];
        let mut found = front(&goals);
        found.sort_unstable();
        assert_eq!(found, [0, 1, 4]);
    }

    proptest! {
        #[test]
        fn every_design_is_on_the_front_or_beaten_by_one_that_is(
            goals in prop::collection::vec([0..6_u8, 0..6, 0..6], 1..80),
        ) {
            let goals: Vec<[f64; 3]> = goals.iter().map(|goal| goal.map(f64::from)).collect();
            let found = front(&goals);
            for (i, goal) in goals.iter().enumerate() {
                let beaten = goals.iter().any(|other| beats(other, goal));
                prop_assert_eq!(found.contains(&i), !beaten);
                let by_front = found.iter().any(|one| beats(&goals[*one], goal));
                prop_assert_eq!(by_front, beaten);
            }
        }
    }
}
