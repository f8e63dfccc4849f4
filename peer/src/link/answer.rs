//! Answering what others ask, on a thread of its own because replies may block.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, TrySendError, sync_channel};

use zenoh::Wait;
use zenoh::key_expr::KeyExpr;
use zenoh::query::Query;

use super::{Counters, LinkError};

/// What a vehicle can answer with.
pub trait Holdings: Send + Sync + 'static {
    /// The reason, if the question makes no sense.
    fn answer(&self, question: &Question) -> Result<Vec<Answer>, String>;
}

/// One reply.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    pub key: String,
    pub payload: Arc<[u8]>,
}

/// A key expression and parameters, as somebody asked them.
pub struct Question {
    expression: KeyExpr<'static>,
    parameters: String,
}

impl Question {
    /// A question from the text of a selector; `None` if that is no key expression.
    pub fn parse(selector: &str) -> Option<Self> {
        let (expression, parameters) = selector.split_once('?').unwrap_or((selector, ""));
        Some(Self {
            expression: KeyExpr::try_from(expression.to_owned()).ok()?,
            parameters: parameters.to_owned(),
        })
    }

    /// Whether an answer with this key is wanted.
    pub fn asks_for(&self, key: &str) -> bool {
        KeyExpr::try_from(key).is_ok_and(|key| self.expression.intersects(&key))
    }

    /// What follows the `?`.
    pub fn parameters(&self) -> &str {
        &self.parameters
    }
}

/// Questions that wait; more are refused with an error.
const QUESTION_LIMIT: usize = 64;

pub(super) fn declare(
    session: &zenoh::Session,
    id: &str,
    holdings: Arc<dyn Holdings>,
    counters: &Arc<Counters>,
) -> Result<(), LinkError> {
    let (sender, receiver) = sync_channel::<Query>(QUESTION_LIMIT);
    let own_counters = Arc::clone(counters);
    std::thread::spawn(move || answer_all(&receiver, holdings.as_ref(), &own_counters));
    let keys = [
        "anchor/*/map/**".to_owned(),
        "anchor/*/placement/**".to_owned(),
        format!("vehicle/{id}/chunk/**"),
        format!("vehicle/{id}/have"),
    ];
    for key in keys {
        let sender = sender.clone();
        // Never `complete`: a query may then ask one holder only.
        session
            .declare_queryable(&key)
            .callback(move |query| {
                if let Err(TrySendError::Full(query)) = sender.try_send(query) {
                    let _ = query.reply_err("busy").wait();
                }
            })
            .background()
            .wait()
            .map_err(|error| LinkError::declare(&key, &error))?;
    }
    Ok(())
}

fn answer_all(questions: &Receiver<Query>, holdings: &dyn Holdings, counters: &Counters) {
    while let Ok(query) = questions.recv() {
        let question = Question {
            expression: query.key_expr().clone(),
            parameters: query.parameters().as_str().to_owned(),
        };
        let answers = match holdings.answer(&question) {
            Ok(answers) => answers,
            Err(reason) => {
                if let Err(error) = query.reply_err(reason).wait() {
                    tracing::debug!(%error, "reply failed");
                }
                continue;
            }
        };
        for answer in answers {
            let bytes = answer.key.len() + answer.payload.len();
            // Replies travel with the priority of the question.
            let reply = query.reply(answer.key.as_str(), answer.payload.as_ref());
            match reply.wait() {
                Ok(()) => counters.count_sent(bytes),
                Err(error) => tracing::debug!(%error, key = answer.key, "reply failed"),
            }
        }
    }
}
