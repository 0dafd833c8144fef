//! The control arm: the effect of each family of perturbations.

use robogate_gate::Twins;

use super::{Block, Section, Table};
use crate::document::Kind::{Number, Short, Text};
use crate::gate::TwinRow;

pub(super) fn section(twins: &Twins) -> Section {
    let rows = twins.families.iter().map(|family| TwinRow::of(family).cells().to_vec()).collect();
    let [family, pairs, difference, interval, effect] = TwinRow::HEADS;
    let columns = [(family, Text), (pairs, Text), (difference, Number), (interval, Number), (effect, Short)];
    let mut table = Table::new("Effect of each perturbation, in percentage points", &columns, rows);
    table.remark = Some(
        "Success with the perturbation minus success without it, on the same seeds. The intervals of all rows hold together. An \
         effect is called harmful or beneficial only if its interval excludes 0."
            .to_owned(),
    );
    Section {
        id: "twins",
        title: "Control arm".to_owned(),
        population: Some(
            "Applies to pairs of an episode and its nominal twin: the same seed without the perturbation.".to_owned(),
        ),
        blocks: vec![Block::List(twins.lines()), Block::Table(table)],
    }
}
