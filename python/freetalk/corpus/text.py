"""English sentences for the synthetic speech: a hand-written list and a grammar that composes many more.

All sentences were written for this corpus. They are chosen to be rich in lip sounds: closures (p b m), lip to teeth
(f v), rounding (u o w sh ch r) and spreading (i e s).
"""

from __future__ import annotations

import numpy as np

WRITTEN = """
People buy five blue shoes before the summer fair.
My mother moved above the village shop in May.
Five brave boys found a very big map of the moon.
Would you move the wooden box above the window?
She sees three green trees by the sea.
Poor Bob never believed the boat would float.
The farmer's wife makes fresh bread from barley and beans.
A thick fog rolled over the harbour before breakfast.
We were warned about the wolves in the western woods.
Do you know who owns the yellow umbrella?
Please bring me a cup of peppermint tea and a piece of pie.
Every evening the old piano plays by itself.
The judge chose a cheap orange jacket for the children.
Maybe we should both leave before the film finishes.
Put the blue book back on the top shelf.
I would rather walk home than wait for another bus.
Five hundred bees buzzed above the lavender bushes.
My baby brother bumped his elbow on the bathroom door.
Few people remember the name of that famous poem.
Why do you always whisper when we are alone?
The mayor promised to improve the public park by April.
Fresh fish and fried potatoes are very filling.
Could you show me how the machine works?
Shy sheep shelter from the sharp winter showers.
Move the lamp; it makes the paper look purple.
He carefully poured warm water over the coffee beans.
Nobody knows how the fire began in the empty mill.
Both of us have a fever and a mild cough.
The view from above the valley was never more beautiful.
Jump over the puddle and push the heavy gate.
Oh no, you forgot to phone the plumber again!
What a wonderful idea, let us begin on Wednesday.
Seven silver spoons were stolen from the museum.
The choir chose a cheerful tune for the church wedding.
Behind the barn a brown mare and her foal were sleeping.
Ask him how many apples he needs for the pie.
Pam packed a pair of pink pyjamas and a pillow.
Vivian moved the vase of violets from the veranda.
Bring the broom and sweep the room before noon.
You may borrow my umbrella, but bring it back by Monday.
Whose turn is it to wash the oven?
The boy blew a huge bubble and it burst on his nose.
I feel so happy for you and for your family.
Watch out, the floor is wet and slippery.
Our train was late, so we missed the opening speech.
Thirty thousand thieves threw thorns at the throne.
Father thought that the weather would be rather smooth.
Beautiful music filled the room from wall to wall.
A small amount of pepper improves most soups.
Keep calm and carry the green key to the kitchen.
The queen quickly quit the quiet quarrel.
George imagined a giant bridge of orange jelly.
The doctor gave her a long lecture about sleep.
My favourite food is beef with mushrooms and barley.
Open your mouth wide and say a long ah.
How now, brown cow, are you over the moon?
Above all, we must not frighten the puppies.
A bump on the map means a mountain, Mum explained.
When will the mail from Vermont arrive?
He owes the bank more money than he can pay.
Ruth drew two blue circles on the school roof.
Each teacher reached the beach by the steep street.
Few of you would choose to chew that shoe.
Paul thought the small hall was awfully warm.
My bike has a broken brake and a bent pump.
Perhaps the bishop will approve of the boy's behaviour.
The shepherd has a full beard and a funny voice.
Bob, Pam and Mabel brought a lamp from Bombay.
I have never heard of such a foolish rumour.
Move forward, move back, and move your feet to the beat.
Even the smallest improvement makes me feel proud.
Fifty-five elephants followed the path to the river.
We played a board game by the fireplace until midnight.
It was a warm, peaceful evening in early September.
The woman at the window waved a white handkerchief.
Why would anyone want to swim in that swamp?
The new law will affect every family in the village.
Tomorrow morning the ship leaves for Portugal.
Do not put pebbles or plums in the pump.
The pilot spoke calmly over the loud speaker.
A good book, a blanket and a pot of cocoa are enough.
I am afraid that the bridge will not bear the weight.
Humming is like singing with a closed mouth.
The jury was shown a film about the vanished jewels.
Voices from the cave frightened the five young men.
You look as if you have just seen a ghost.
Pick a number between zero and a million.
My uncle built a small wooden boat for Emma.
At first I believed every word of the story.
Have you ever tried to balance a spoon on your nose?
Plenty of pepper, a bit of butter, and it is perfect.
Meet me by the main gate at a quarter past four.
The boss was furious because nobody read the memo.
Whoever wins the match will be on the front page.
Each page of the album has a picture of a butterfly.
They say that honey never goes bad.
Our neighbours have a puppy, two rabbits and a pony.
We bought a map, a pump, a lamp and a bag of plums.
The rose bush by the porch blooms from May to November.
Just imagine a measure of pleasure in usual leisure.
""".strip().splitlines()

OPENERS = (
    "", "", "", "", "Maybe", "Perhaps", "In the morning", "Before breakfast", "Every summer", "By the way,", "Of course",
    "Last Monday", "To my surprise", "For a while", "Now and then", "Believe me,", "As far as I know,",
)  # fmt: skip
SUBJECTS = (
    "my mother", "the farmer", "a brave woman", "the old fisherman", "our neighbour", "the new teacher", "Bob",
    "a young musician", "the pilot", "everybody", "the baker's boy", "my best friend", "the famous writer", "Emma",
    "the village doctor", "a shy visitor", "the bus driver", "your father", "the chief of police", "Mabel", "Philip",
    "the tall waiter", "a group of children", "the whole family", "Joshua", "the woman from Bermuda", "nobody",
    "the sheep dog", "the museum guide", "that funny fellow", "the queen", "Professor Brown", "a wolf", "the choir",
)  # fmt: skip
VERBS = (
    "moved", "bought", "found", "showed us", "forgot", "believed in", "painted", "borrowed", "removed", "carried",
    "watched", "broke", "opened", "loved", "washed", "wrapped", "pushed", "threw away", "remembered", "chose",
    "would never leave", "must improve", "may keep", "should have saved", "promised to bring", "photographed",
    "was looking for", "complained about", "has never seen", "picked up", "measured", "refused to move",
)  # fmt: skip
ADJECTIVES = (
    "", "", "big", "blue", "very small", "beautiful", "broken", "wooden", "famous", "purple", "heavy", "fresh",
    "yellow", "marvellous", "cheap", "empty", "warm", "fragile", "peculiar", "brown", "smooth", "huge", "silver",
)  # fmt: skip
NOUNS = (
    "map", "boat", "umbrella", "piano", "window", "book", "vase", "lamp", "bag of apples", "photograph", "bridge",
    "pumpkin", "shoe box", "violin", "bottle", "camera", "blanket", "bowl of soup", "mushroom pie", "computer",
    "fireplace", "wooden spoon", "leather jacket", "bicycle", "bathroom mirror", "cup of coffee", "village church",
    "poem", "jar of honey", "telephone", "chess board", "woollen glove", "flower pot", "paper aeroplane",
)  # fmt: skip
PLACES = (
    "", "", "from the museum", "by the river", "above the bakery", "in Vermont", "on the roof", "for the mayor",
    "before the film", "from my room", "at the bus stop", "in the middle of the forest", "near the harbour",
    "with both hands", "over the weekend", "under the bridge", "behind the old barn", "after the show",
    "in front of the shop", "without a word", "for a few pounds", "as if by magic", "in the pouring rain",
)  # fmt: skip
ENDINGS = (".", ".", ".", ".", "!", ", and we were amused.", ", but it was too late.", ", which made us laugh.",
           ", so I phoned the police.", ", if you know what I mean.")  # fmt: skip
SPLITS = ("train", "val", "test")


def compose(rng: np.random.Generator) -> str:
    """One sentence of the grammar."""

    def pick(options: tuple[str, ...]) -> str:
        return options[int(rng.integers(len(options)))]

    adjective = pick(ADJECTIVES)
    noun = f"{adjective} {pick(NOUNS)}".strip()
    article = pick(("the", "the", "my", "our", "that", "every", "another"))
    words = (pick(OPENERS), pick(SUBJECTS), pick(VERBS), article, noun, pick(PLACES))
    sentence = " ".join(word for word in words if word)
    return sentence[0].upper() + sentence[1:] + pick(ENDINGS)


def sentences(counts: dict[str, int], seed: int) -> dict[str, list[str]]:
    """Distinct sentences for each split; no sentence occurs in two splits.

    Args:
        counts: how many sentences each of train, val, test needs.
        seed: of the composition and the assignment.
    """
    rng = np.random.default_rng([seed, 7])
    total = sum(counts.get(split, 0) for split in SPLITS)
    pool = list(WRITTEN)
    rng.shuffle(pool)
    seen = set(pool)
    while len(pool) < total:
        sentence = compose(rng)
        if sentence not in seen:
            seen.add(sentence)
            pool.append(sentence)
    order = rng.permutation(total)
    result, start = {}, 0
    for split in SPLITS:
        result[split] = [pool[i] for i in order[start : start + counts.get(split, 0)]]
        start += counts.get(split, 0)
    return result
