//! All recipes together.

use std::collections::BTreeMap;

use crate::alarm::Alarm;
use crate::cycle::Cycle;
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

    /// Gives a recipe back what it remembered. Evidence that does not fit the settings starts again from nothing.
    pub fn restore(&mut self, name: &str, state: RecipeState) {
        self.recipes.insert(name.to_owned(), Recipe::restore(state, &self.settings));
    }

    /// Whether a cycle of this recipe would be taken.
    ///
    /// # Errors
    /// The recipe is new and there is no room for it.
    pub fn has_room(&self, recipe: &str) -> Result<(), TooManyRecipes> {
        let most = self.settings.most_recipes;
        if self.recipes.len() < most as usize || self.recipes.contains_key(recipe) {
            Ok(())
        } else {
            Err(TooManyRecipes { recipe: recipe.to_owned(), most })
        }
    }

    /// Takes in one cycle, in the order of arrival; what happens to alarms is handed to `said`.
    ///
    /// The cycle is one that passed [`Cycle::check`]. Allocates nothing but at an alarm, for a recipe or robot never heard
    /// before, and where learning ends.
    ///
    /// # Errors
    /// The recipe is new and there is no room for it.
    pub fn observe(&mut self, cycle: &Cycle, said: &mut dyn FnMut(Alarm)) -> Result<(), TooManyRecipes> {
        if let Some(recipe) = self.recipes.get_mut(cycle.recipe.as_str()) {
            recipe.observe(cycle, &self.settings, said);
            return Ok(());
        }
        self.has_room(&cycle.recipe)?;
        let mut recipe = Recipe::new(self.settings.baseline_of(&cycle.recipe).clone(), &self.settings);
        recipe.observe(cycle, &self.settings, said);
        self.recipes.insert(cycle.recipe.clone(), recipe);
        Ok(())
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
