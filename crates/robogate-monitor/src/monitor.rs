//! All recipes together.

use std::collections::BTreeMap;

use crate::alarm::Alarm;
use crate::cycle::Cycle;
use crate::domain::Judged;
use crate::recipe::{Recipe, RecipeState};
use crate::settings::{Settings, SettingsError};

/// The monitor: cycles in, alarms out.
///
/// It has no clock, no file and no randomness: the same settings and cycles give the same alarms, bit for bit.
#[derive(Debug, Clone, PartialEq)]
pub struct Monitor {
    settings: Settings,
    recipes: BTreeMap<String, Recipe>,
}

/// Why a cycle was not taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("recipe `{recipe}` is one more than the {most} that are watched; hint: `most_recipes`")]
pub struct TooManyRecipes {
    /// The recipe refused.
    pub recipe: String,
    /// Most recipes.
    pub most: u32,
}

impl Monitor {
    /// A monitor that has heard nothing.
    ///
    /// # Errors
    /// Settings that cannot be.
    pub fn new(settings: Settings) -> Result<Self, SettingsError> {
        settings.check()?;
        Ok(Self { settings, recipes: BTreeMap::new() })
    }

    /// Gives a recipe back what it remembered: see [`Recipe::restore`].
    pub fn restore(&mut self, name: &str, state: RecipeState) {
        self.recipes.insert(name.to_owned(), Recipe::restore(name, state, &self.settings));
    }

    /// Whether a cycle of this recipe would be taken after `others` more that are new.
    ///
    /// # Errors
    /// The recipe is new and there is no room for it.
    pub fn has_room(&self, recipe: &str, others: usize) -> Result<(), TooManyRecipes> {
        let most = self.settings.most_recipes;
        if self.recipes.len() + others < most as usize || self.recipes.contains_key(recipe) {
            Ok(())
        } else {
            Err(TooManyRecipes { recipe: recipe.to_owned(), most })
        }
    }

    /// Takes in one cycle, in the order of arrival; what happens to alarms is handed to `said`, and what is said of its
    /// parameters returned.
    ///
    /// The cycle is one that passed [`Cycle::check`]. Allocates nothing but at an alarm, for a recipe or robot never heard
    /// before, and where learning ends.
    ///
    /// # Errors
    /// The recipe is new and there is no room for it.
    pub fn observe(&mut self, cycle: &Cycle, said: &mut dyn FnMut(Alarm)) -> Result<Judged, TooManyRecipes> {
        if let Some(recipe) = self.recipes.get_mut(cycle.recipe.as_str()) {
            return Ok(recipe.observe(cycle, &self.settings, said));
        }
        self.has_room(&cycle.recipe, 0)?;
        let mut recipe = Recipe::new(&cycle.recipe, &self.settings);
        let judged = recipe.observe(cycle, &self.settings, said);
        self.recipes.insert(cycle.recipe.clone(), recipe);
        Ok(judged)
    }

    /// How many recipes there are.
    pub fn len(&self) -> usize {
        self.recipes.len()
    }

    /// Whether nothing was heard yet.
    pub fn is_empty(&self) -> bool {
        self.recipes.is_empty()
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// A recipe, by name.
    pub fn recipe(&self, name: &str) -> Option<&Recipe> {
        self.recipes.get(name)
    }

    /// A recipe, to restart it.
    pub fn recipe_mut(&mut self, name: &str) -> Option<&mut Recipe> {
        self.recipes.get_mut(name)
    }

    /// The recipes, by name.
    pub fn recipes(&self) -> impl Iterator<Item = (&str, &Recipe)> {
        self.recipes.iter().map(|(name, recipe)| (name.as_str(), recipe))
    }
}
